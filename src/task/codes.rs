//! Diagnostic codes of shards.

crate::diagnostic_codes! {
    "codes.md":
    /// A shard that was changed or damaged, or does not belong to the others.
    INVALID_SHARD = "invalid-shard", Error;
}
