// Types of ../codemirror.js, for the type checker: those of the packages that it is made of.
export * from '@codemirror/autocomplete';
export * from '@codemirror/commands';
export * from '@codemirror/language';
export * from '@codemirror/lint';
export * from '@codemirror/search';
export * from '@codemirror/state';
export * from '@codemirror/view';
export { tags } from '@lezer/highlight';
import type { LRLanguage, LanguageSupport } from '@codemirror/language';
export declare const jobLanguage: LRLanguage;
export declare function job(): LanguageSupport;
