//! The stable names of all messages.

use crate::diag::Severity;

/// Declares the codes: variant, name, severity. The name is part of the public interface and never changes its meaning. Each
/// has a fixture in `tests/fixtures/diagnostics/` and a section in `rules/README.md` (rules, facts) or `configs/README.md`
/// (configuration, maps, scenes); a test checks that both exist.
macro_rules! codes {
    ($($(#[$doc:meta])* $variant:ident = $name:literal, $severity:ident;)*) => {
        /// The stable name of a message.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Code { $($(#[$doc])* $variant,)* }

        impl Code {
            /// Every code there is.
            pub const ALL: &[Code] = &[$(Code::$variant,)*];

            /// The name shown to users, for example `unknown-predicate`.
            pub fn name(self) -> &'static str {
                match self { $(Code::$variant => $name,)* }
            }

            /// Whether the message is an error or a warning.
            pub fn severity(self) -> Severity {
                match self { $(Code::$variant => Severity::$severity,)* }
            }
        }
    };
}

codes! {
    // --- any file
    /// The bytes of a file are not UTF-8 text.
    NotText = "not-text", Error;
    /// A size or count in the input is beyond what the program accepts.
    LimitExceeded = "limit-exceeded", Error;

    // --- rules
    /// The text does not follow the grammar.
    Syntax = "syntax", Error;
    /// A feature of Soufflé that this language does not have.
    Unsupported = "unsupported", Error;
    /// A predicate that is not declared.
    UnknownPredicate = "unknown-predicate", Error;
    /// A type that is not declared.
    UnknownType = "unknown-type", Error;
    /// A type that is its own ancestor.
    CyclicType = "cyclic-type", Error;
    /// An atom with more or fewer arguments than its predicate's declaration.
    ArityMismatch = "arity-mismatch", Error;
    /// A term of one type where another is needed.
    TypeMismatch = "type-mismatch", Error;
    /// A variable that no positive atom of the body binds.
    UnboundVariable = "unbound-variable", Error;
    /// A predicate that depends on its own negation.
    CyclicNegation = "cyclic-negation", Error;
    /// A predicate or type declared twice.
    DuplicateDeclaration = "duplicate-declaration", Error;
    /// A file that includes itself, directly or through others.
    IncludeCycle = "include-cycle", Error;
    /// An included file that cannot be read.
    MissingInclude = "missing-include", Error;
    /// A predicate that is input and also head of a rule.
    DerivedInput = "derived-input", Error;
    /// The same where both are meant to hold: the given rows and the derived ones.
    ExtendedInput = "extended-input", Warning;
    /// A `.scope` that cannot guard the rules it is given.
    InvalidScope = "invalid-scope", Error;
    /// A promise that its predicates cannot keep: they are derived, or their columns do not fit it.
    InvalidPromise = "invalid-promise", Error;
    /// A named variable that occurs only once in its rule.
    SingletonVariable = "singleton-variable", Warning;
    /// A clause that derives nothing another clause does not.
    SubsumedClause = "subsumed-clause", Warning;
    /// A clause equal to another, up to the names of variables and the order of literals.
    DuplicateClause = "duplicate-clause", Warning;
    /// A clause that can never fire, since a predicate it needs is always empty.
    DeadClause = "dead-clause", Warning;
    /// Something of Soufflé that is accepted and has no effect here.
    Ignored = "ignored", Warning;
    /// A declaration of a type as older versions of Soufflé write it.
    OldForm = "old-form", Warning;

    /// A body two literals of which never hold together.
    ContradictoryBody = "contradictory-body", Warning;
    /// A literal that others imply.
    RedundantLiteral = "redundant-literal", Warning;
    /// Several literals that stand together in several clauses.
    RepeatedBody = "repeated-body", Warning;

    // --- facts
    /// A row of a facts file that does not fit its predicate's declaration.
    InvalidFact = "invalid-fact", Error;
    /// Facts that are not as the rules promise.
    BrokenPromise = "broken-promise", Error;

    // --- configuration
    /// The text is not YAML.
    YamlSyntax = "yaml-syntax", Error;
    /// A key that has no meaning here.
    UnknownKey = "unknown-key", Error;
    /// A key given twice.
    DuplicateKey = "duplicate-key", Error;
    /// A required key that is absent.
    MissingKey = "missing-key", Error;
    /// A value of the wrong type or outside its range.
    InvalidValue = "invalid-value", Error;
    /// A file that a configuration refers to and that cannot be read.
    MissingFile = "missing-file", Error;
    /// A split that the configuration does not have.
    UnknownSplit = "unknown-split", Error;
    /// Rules and configuration do not fit: an input predicate or an action that the other side does not have.
    RuleMismatch = "rule-mismatch", Error;

    // --- city
    /// A map that cannot be generated.
    InvalidMap = "invalid-map", Error;
    /// More agents than cells they could start from, or none at all.
    NoStartCell = "no-start-cell", Error;
    /// A goal that cannot be reached.
    NoRoute = "no-route", Error;

    // --- scenes
    /// A scene that is not JSON or does not follow the scene format.
    InvalidScene = "invalid-scene", Error;

    // --- episodes
    /// An episode that is not of its format, or that cannot begin in its city.
    InvalidEpisode = "invalid-episode", Error;

    // --- data sets
    /// A data set that is not as it was made, or of another configuration.
    InvalidDataSet = "invalid-data-set", Error;

    // --- traces
    /// A trace that is not JSON or does not follow the trace format.
    InvalidTrace = "invalid-trace", Error;
    /// A trace of another configuration or of other rules.
    TraceMismatch = "trace-mismatch", Error;
}
