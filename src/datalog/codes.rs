//! Codes of diagnostics about rules and facts.

crate::diagnostic_codes! {
    "codes.md":
    /// The text does not follow the grammar.
    SYNTAX = "syntax", Error;
    /// A feature of Soufflé that this language does not have, or one of Prolog that the reader of tasks does not have.
    UNSUPPORTED = "unsupported", Error;
    /// A predicate that is not declared.
    UNKNOWN_PREDICATE = "unknown-predicate", Error;
    /// A type that is not declared.
    UNKNOWN_TYPE = "unknown-type", Error;
    /// A column that the declaration of a predicate does not have.
    UNKNOWN_COLUMN = "unknown-column", Error;
    /// A functor that is not declared.
    UNKNOWN_FUNCTOR = "unknown-functor", Error;
    /// A macro that is used in place of a clause and that no `#define` defines.
    UNKNOWN_MACRO = "unknown-macro", Error;
    /// A functor without a definition, or one whose definition fails.
    FAILED_FUNCTOR = "failed-functor", Error;
    /// A type that is its own ancestor, directly or through others.
    CYCLIC_TYPE = "cyclic-type", Error;
    /// An atom with more or fewer arguments than its predicate's declaration.
    ARITY_MISMATCH = "arity-mismatch", Error;
    /// A term of one type where another is needed.
    TYPE_MISMATCH = "type-mismatch", Error;
    /// A constant that is not a regular expression where one is needed.
    INVALID_PATTERN = "invalid-pattern", Error;
    /// An `.output` whose file has an impossible name, is outside of the folder of results, or is that of another
    /// output.
    INVALID_OUTPUT = "invalid-output", Error;
    /// A variable that no positive atom of the body binds.
    UNBOUND_VARIABLE = "unbound-variable", Error;
    /// A predicate that depends on its own negation.
    CYCLIC_NEGATION = "cyclic-negation", Error;
    /// A predicate or type declared twice.
    DUPLICATE_DECLARATION = "duplicate-declaration", Error;
    /// A file that includes itself, directly or through others.
    INCLUDE_CYCLE = "include-cycle", Error;
    /// A directive of the preprocessor that cannot be followed, `#error`, or a faulty use of a macro.
    PREPROCESSOR = "preprocessor", Error;
    /// A component that no file declares.
    UNKNOWN_COMPONENT = "unknown-component", Error;
    /// A component with other parameters, that contains itself, or that overrides what it must not.
    INVALID_COMPONENT = "invalid-component", Error;
    /// An included file that cannot be read.
    MISSING_INCLUDE = "missing-include", Error;
    /// An `.input` predicate that is also the head of a rule.
    DERIVED_INPUT = "derived-input", Error;
    /// An `.input` predicate that is also the head of a rule, where inputs are extensible: both sets of rows hold.
    EXTENDED_INPUT = "extended-input", Warning;
    /// A `.scope` that cannot guard the rules it applies to.
    INVALID_SCOPE = "invalid-scope", Error;
    /// A temporal operator with an impossible window, or applied to something other than an atom of variables and
    /// constants.
    INVALID_TEMPORAL = "invalid-temporal", Error;
    /// A probability outside of 0 to 1, alternatives that add up to more than 1, or a probability where there can be
    /// none.
    INVALID_PROBABILITY = "invalid-probability", Error;
    /// A constraint on derived predicates, or on columns of unsuitable types or number.
    INVALID_CONSTRAINT = "invalid-constraint", Error;
    /// A named variable that occurs only once in its rule.
    SINGLETON_VARIABLE = "singleton-variable", Warning;
    /// An equation that is always true, because one of its variables occurs nowhere else.
    VACUOUS_EQUATION = "vacuous-equation", Warning;
    /// A clause whose rows another clause derives as well.
    SUBSUMED_CLAUSE = "subsumed-clause", Warning;
    /// A clause equal to another up to variable names and the order of literals.
    DUPLICATE_CLAUSE = "duplicate-clause", Warning;
    /// A clause that never fires, because a predicate it needs is always empty or its probability is 0.
    DEAD_CLAUSE = "dead-clause", Warning;
    /// A feature of Soufflé, or a declaration of a task, that is accepted and has no effect here.
    IGNORED = "ignored", Warning;
    /// A type declaration or a string in the notation of older Soufflé versions.
    OLD_FORM = "old-form", Warning;
    /// A body with two literals that never hold together.
    CONTRADICTORY_BODY = "contradictory-body", Warning;
    /// A literal that other literals of the body imply.
    REDUNDANT_LITERAL = "redundant-literal", Warning;
    /// A group of literals that several clauses repeat.
    REPEATED_BODY = "repeated-body", Warning;
    /// A row of a facts file, or an example of a task, that does not fit its predicate's declaration.
    INVALID_FACT = "invalid-fact", Error;
    /// Facts that violate a constraint.
    CONSTRAINT_VIOLATION = "constraint-violation", Error;
    /// Two rule sets, or rules and a configuration, that do not fit: one side lacks an input predicate or an action of
    /// the other.
    RULE_MISMATCH = "rule-mismatch", Error;
}
