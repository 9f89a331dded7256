//! Declarations of the Embree 4.3+ C ABI that a renderer needs: types, constants, functions.
//!
//! Invariant: every struct has the size and alignment that Embree 4.3 and later expect when built with
//! one instance level and instance arrays (both are its defaults); the assertions in [`ray`] and
//! [`types`] hold it at compile time. Before the first query, check that
//! [`RTC_DEVICE_PROPERTY_VERSION`] lies in [`VERSION_FIRST`]` .. `[`VERSION_PAST`]: 4.0 to 4.2 have a
//! smaller hit record, and nothing is promised past 4.
//! Never: wraps, checks, builds, or looks for the library. Names are Embree's own, so that its manual
//! serves as theirs. Source: the API chapter of the Embree 4 manual.
#![allow(
    non_snake_case,
    non_camel_case_types,
    reason = "Embree's own names: a reader looks them up in its manual"
)]

mod constants;
mod functions;
mod ray;
mod types;

pub use constants::*;
pub use functions::*;
pub use ray::*;
pub use types::*;

/// The least [`RTC_DEVICE_PROPERTY_VERSION`] with this ABI: 4.3.0, as major * 10000 + minor * 100 + patch.
pub const VERSION_FIRST: isize = 40_300;
/// The first [`RTC_DEVICE_PROPERTY_VERSION`] past those that promise this ABI: 5.0.0.
pub const VERSION_PAST: isize = 50_000;
