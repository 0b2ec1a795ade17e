//! The `logicity` command.
fn main() {}
