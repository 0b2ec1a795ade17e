//! The codes of messages about rules and facts.

crate::diagnostic_codes! {
    /// The text does not follow the grammar.
    SYNTAX = "syntax", Error;
    /// A feature of Soufflé that this language does not have.
    UNSUPPORTED = "unsupported", Error;
    /// A predicate that is not declared.
    UNKNOWN_PREDICATE = "unknown-predicate", Error;
    /// A type that is not declared.
    UNKNOWN_TYPE = "unknown-type", Error;
    /// A type that is its own ancestor.
    CYCLIC_TYPE = "cyclic-type", Error;
    /// An atom with more or fewer arguments than its predicate's declaration.
    ARITY_MISMATCH = "arity-mismatch", Error;
    /// A term of one type where another is needed.
    TYPE_MISMATCH = "type-mismatch", Error;
    /// A variable that no positive atom of the body binds.
    UNBOUND_VARIABLE = "unbound-variable", Error;
    /// A predicate that depends on its own negation.
    CYCLIC_NEGATION = "cyclic-negation", Error;
    /// A predicate or type declared twice.
    DUPLICATE_DECLARATION = "duplicate-declaration", Error;
    /// A file that includes itself, directly or through others.
    INCLUDE_CYCLE = "include-cycle", Error;
    /// An included file that cannot be read.
    MISSING_INCLUDE = "missing-include", Error;
    /// A predicate that is input and also head of a rule.
    DERIVED_INPUT = "derived-input", Error;
    /// The same where both are meant to hold: the given rows and the derived ones.
    EXTENDED_INPUT = "extended-input", Warning;
    /// A `.scope` that cannot guard the rules it is given.
    INVALID_SCOPE = "invalid-scope", Error;
    /// A constraint on derived predicates, or on columns that do not fit it.
    INVALID_CONSTRAINT = "invalid-constraint", Error;
    /// A named variable that occurs only once in its rule.
    SINGLETON_VARIABLE = "singleton-variable", Warning;
    /// A clause that derives nothing another clause does not.
    SUBSUMED_CLAUSE = "subsumed-clause", Warning;
    /// A clause equal to another, up to the names of variables and the order of literals.
    DUPLICATE_CLAUSE = "duplicate-clause", Warning;
    /// A clause that can never fire, since a predicate it needs is always empty.
    DEAD_CLAUSE = "dead-clause", Warning;
    /// Something of Soufflé that is accepted and has no effect here.
    IGNORED = "ignored", Warning;
    /// A declaration of a type as older versions of Soufflé write it.
    OLD_FORM = "old-form", Warning;
    /// A body two literals of which never hold together.
    CONTRADICTORY_BODY = "contradictory-body", Warning;
    /// A literal that others imply.
    REDUNDANT_LITERAL = "redundant-literal", Warning;
    /// Several literals that stand together in several clauses.
    REPEATED_BODY = "repeated-body", Warning;
    /// A row of a facts file that does not fit its predicate's declaration.
    INVALID_FACT = "invalid-fact", Error;
    /// Facts that violate a constraint.
    CONSTRAINT_VIOLATION = "constraint-violation", Error;
    /// Two rule sets, or rules and a configuration, do not fit: an input predicate or an action that the other side does not have.
    RULE_MISMATCH = "rule-mismatch", Error;
}
