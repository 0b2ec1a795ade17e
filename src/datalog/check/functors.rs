//! Definitions of user-defined functors.

use crate::symbol::Symbols;
use crate::value::Value;
use std::fmt;
use std::sync::Arc;

/// Calls of a functor that are evaluated together.
#[derive(Clone, Copy, Debug)]
pub struct FunctorBatch<'a> {
    rows: &'a [Value],
    count: usize,
    arity: usize,
    symbols: &'a Symbols,
}

impl<'a> FunctorBatch<'a> {
    /// A batch of `count` rows of arguments, in row-major order.
    pub(crate) fn new(rows: &'a [Value], (count, arity): (usize, usize), symbols: &'a Symbols) -> Self {
        FunctorBatch {
            rows,
            count,
            arity,
            symbols,
        }
    }

    /// Returns the number of calls.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are no calls.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the arguments of a call.
    ///
    /// # Panics
    /// If there is no such call.
    pub fn row(&self, call: usize) -> &'a [Value] {
        &self.rows[call * self.arity..(call + 1) * self.arity]
    }

    /// Returns the symbols of the arguments and of the results. Functors may add some.
    pub fn symbols(&self) -> &'a Symbols {
        self.symbols
    }
}

/// What a definition does: it adds a value for each call.
type Apply = dyn Fn(&FunctorBatch<'_>, &mut Vec<Option<Value>>) -> Result<(), String> + Send + Sync;

/// What computes the values of a functor.
#[derive(Clone)]
pub(crate) struct Definition(pub(crate) Arc<Apply>);

impl fmt::Debug for Definition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Definition")
    }
}

/// Why a program refuses the definition of a functor.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FunctorError {
    /// The program declares no such functor.
    Unknown {
        /// The name.
        functor: String,
        /// A functor with a similar name.
        near: Option<String>,
    },
    /// The closure takes other arguments.
    Arguments {
        /// The name.
        functor: String,
        /// What does not fit.
        reason: String,
    },
}

impl fmt::Display for FunctorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FunctorError::Unknown { functor, near } => {
                write!(f, "the program declares no functor `{functor}`")?;
                match near {
                    Some(near) => write!(f, "; did you mean `{near}`?"),
                    None => Ok(()),
                }
            }
            FunctorError::Arguments { functor, reason } => write!(f, "the functor `{functor}`: {reason}"),
        }
    }
}

impl std::error::Error for FunctorError {}
