//! From text to checked rules.

mod rules;

pub use rules::{
    Atom, BaseType, Clause, ClauseId, Column, Comparison, Literal, RelId, Relation, Rules, Stratum, Term, Type, TypeId,
    Value, VarId,
};
