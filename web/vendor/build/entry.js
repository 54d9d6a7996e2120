// The parts of CodeMirror 6 that the page uses, and the language of job files.
import { parser as jobParser } from 'job-parser';
import {
  LRLanguage,
  LanguageSupport,
  foldInside,
  foldNodeProp,
  indentNodeProp,
  continuedIndent,
} from '@codemirror/language';
import { styleTags, tags } from '@lezer/highlight';

export {
  acceptCompletion,
  autocompletion,
  closeBrackets,
  closeBracketsKeymap,
  completionKeymap,
  completionStatus,
  pickedCompletion,
  insertCompletionText,
  snippet,
  startCompletion,
} from '@codemirror/autocomplete';
export {
  defaultKeymap,
  history,
  historyKeymap,
  indentWithTab,
  isolateHistory,
  redo,
  redoDepth,
  toggleComment,
  undo,
  undoDepth,
} from '@codemirror/commands';
export {
  HighlightStyle,
  bracketMatching,
  codeFolding,
  foldAll,
  foldCode,
  foldGutter,
  foldKeymap,
  indentOnInput,
  indentUnit,
  syntaxHighlighting,
  syntaxTree,
  unfoldAll,
  unfoldCode,
} from '@codemirror/language';
export { lintGutter, lintKeymap, nextDiagnostic, openLintPanel, setDiagnostics } from '@codemirror/lint';
export { highlightSelectionMatches, openSearchPanel, search, searchKeymap } from '@codemirror/search';
export { Annotation, ChangeSet, Compartment, EditorSelection, EditorState, Facet, Prec, RangeSetBuilder, StateEffect, StateField, Text, Transaction } from '@codemirror/state';
export {
  Decoration,
  EditorView,
  ViewPlugin,
  WidgetType,
  crosshairCursor,
  drawSelection,
  dropCursor,
  highlightActiveLine,
  highlightActiveLineGutter,
  highlightSpecialChars,
  hoverTooltip,
  keymap,
  lineNumbers,
  placeholder,
  rectangularSelection,
  showTooltip,
  tooltips,
} from '@codemirror/view';
export { tags } from '@lezer/highlight';

/** The language of job files: JSON with comments and trailing commas. */
export const jobLanguage = LRLanguage.define({
  name: 'job',
  parser: jobParser.configure({
    props: [
      styleTags({
        String: tags.string,
        Number: tags.number,
        'True False': tags.bool,
        PropertyName: tags.propertyName,
        Null: tags.null,
        LineComment: tags.lineComment,
        BlockComment: tags.blockComment,
        ', :': tags.separator,
        '[ ]': tags.squareBracket,
        '{ }': tags.brace,
      }),
      indentNodeProp.add({
        Object: continuedIndent({ except: /^\s*\}/ }),
        Array: continuedIndent({ except: /^\s*\]/ }),
      }),
      foldNodeProp.add({ 'Object Array': foldInside }),
    ],
  }),
  languageData: {
    closeBrackets: { brackets: ['[', '{', '"'] },
    commentTokens: { line: '//', block: { open: '/*', close: '*/' } },
    indentOnInput: /^\s*[}\]]$/,
  },
});

/** The language and what belongs to it. */
export const job = () => new LanguageSupport(jobLanguage);
