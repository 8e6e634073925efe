// What the editor's page uses of CodeMirror, bundled into one file by `make codemirror`.

export { autocompletion, closeBrackets, closeBracketsKeymap, closeCompletion, completionKeymap, ifNotIn, selectedCompletion } from "@codemirror/autocomplete";
export { defaultKeymap, indentWithTab } from "@codemirror/commands";
export { python } from "@codemirror/lang-python";
export { bracketMatching, HighlightStyle, indentOnInput, indentUnit, syntaxHighlighting } from "@codemirror/language";
export { lintGutter, setDiagnostics } from "@codemirror/lint";
export { Annotation, EditorState, Prec, StateEffect, StateField } from "@codemirror/state";
export { Decoration, drawSelection, EditorView, keymap, lineNumbers, placeholder, WidgetType } from "@codemirror/view";
export { tags } from "@lezer/highlight";
