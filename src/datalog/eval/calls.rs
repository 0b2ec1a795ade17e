//! The user-defined functors that a join applies.

use crate::check::UserFunctor;
use crate::symbol::Symbols;
use crate::value::Value;
use std::sync::{Arc, Mutex, PoisonError};

/// The functors of a program, and the first failure of one of them.
#[derive(Debug)]
pub(crate) struct Calls {
    functors: Arc<[UserFunctor]>,
    /// The name of the functor and the reason.
    failure: Mutex<Option<(String, String)>>,
}

/// A functor has failed; [`Calls::failure`] says why.
#[derive(Debug)]
pub(crate) struct Failed;

impl Calls {
    pub(crate) fn new(functors: &Arc<[UserFunctor]>) -> Arc<Calls> {
        Arc::new(Calls {
            functors: Arc::clone(functors),
            failure: Mutex::new(None),
        })
    }

    /// Returns the values of the functor at a position for rows of arguments in row-major order.
    pub(crate) fn apply(
        &self,
        at: usize,
        (rows, count): (&[Value], usize),
        symbols: &Symbols,
    ) -> Result<Vec<Option<Value>>, Failed> {
        let mut values = Vec::with_capacity(count);
        let functor = self.functors.get(at).ok_or(Failed)?;
        functor.apply((rows, count), symbols, &mut values).map_err(|reason| {
            let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
            failure.get_or_insert((functor.name.clone(), reason));
            Failed
        })?;
        Ok(values)
    }

    /// Returns the name of the functor that failed, and the reason.
    pub(crate) fn failure(&self) -> (String, String) {
        let failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.clone().unwrap_or_default()
    }
}
