//! Values of a configuration with their places.

use crate::diag::Span;
use serde::{Serialize, Serializer};

/// A value and its place in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Located<T> {
    /// The value.
    pub value: T,
    /// The place.
    pub span: Span,
}

/// Serializes the value without its place, so that equal content has equal form.
impl<T: Serialize> Serialize for Located<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.value.serialize(serializer)
    }
}
