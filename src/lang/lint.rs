//! Warnings that need all clauses.

use super::clause::{Checked, Clauses};
use super::faults::Faults;
use super::names::Names;

pub(super) fn dead(_: &Clauses, _: &Names, _: &mut Faults) {}

pub(super) fn redundant(_: &[Checked], _: &mut Faults) {}
