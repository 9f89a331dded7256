//! Measured tables, as constants. Never computes anything: `spectrum` does.

pub(super) mod cie;
pub(super) mod metals;
