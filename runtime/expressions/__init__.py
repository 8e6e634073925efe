"""The one analysis of machines' code: what it reads, whether it only computes, and its values.

Whoever decides from a syntax tree asks here: the checker, the debugger, the verifier and the names
of bundles. Nothing here runs a machine, and of the engine only the table of a class is known.

Read in this order: `reads` (the names in code), `assignment` (names without a value), `purity`
(what only computes), `types`, `evaluation` (the value of an expression), `annotated` (its text with
values), and `guards` (what decides a guard).
"""
