// Shortcuts of the studio, for the list of all shortcuts. The text's are handled by the editor, the picture's by its gestures.

/** @type {import('/ui/parts/shortcuts.js').Shortcut[]} */
export const SHORTCUTS = [
  ...list('Studio: text', [
    ['Ctrl+Space', 'Complete: keys, kinds, words, names'],
    ['Alt+H', 'Help on the place of the cursor'],
    ['Ctrl+.', 'Raise the number at the cursor; with Shift coarse, with Alt fine'],
    ['Ctrl+,', 'Lower it'],
    ['Alt+C', 'Choose the color at the cursor'],
    ['Shift+Alt+F', 'Format the text'],
    ['F8', 'Show the next fault'],
    ['Ctrl+F', 'Search and replace'],
    ['Ctrl+Shift+[', 'Fold; with ] unfold'],
    ['Ctrl+/', 'Make the lines a comment, or text again'],
  ]),
  ...list('Studio: picture', [
    ['↑ ↓ ← →', 'Circle the scene; with Shift move the view, with Alt turn it'],
    ['+ −', 'Come nearer, go away'],
    ['W A S D Q E', 'Fly; with Shift faster'],
    ['f', 'Fly mode: a drag looks around'],
    ['c', 'Crosshair: arrow keys move it'],
    ['Enter', 'Select the object at the crosshair'],
    ['l', 'Look at the point at the crosshair'],
    ['Esc', 'Take a gesture back'],
  ]),
  ...list('Studio', [
    ['Ctrl+Enter', 'Render: submit the job'],
    ['Ctrl+S', 'Save as a file'],
    ['Ctrl+O', 'Open a file'],
    ['Ctrl+Z', 'Undo; with Shift redo'],
  ]),
];

/**
 * @param {string} group
 * @param {[string, string][]} pairs
 */
function list(group, pairs) {
  return pairs.map(([keys, text]) => ({ keys, text, group }));
}
