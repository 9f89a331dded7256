//! Measured tables, as constants. Never computes anything: `spectrum` does.

#[allow(clippy::approx_constant, reason = "measured values that happen to lie near π or 2π")]
pub(super) mod cie;
#[allow(clippy::approx_constant, reason = "measured values that happen to lie near π or 2π")]
pub(super) mod metals;
