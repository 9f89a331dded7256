//! The one integration binary: known answers first, then statistical, then damaged files, then the
//! program as a person meets it, then the house's own rules. One binary, so that one is linked.
//!
//! Invariant: tests run in any order and side by side; what is random has a fixed seed, so that a
//! test which passes once passes always on the same code.
//! Never: needs a network. What needs `../shared` (or `$WEIR_SHARED`) says what it left out.
#![cfg(feature = "embree")]

mod support;

mod filters;
mod known;

mod calibration;
mod determinism;
mod effects;
mod estimators;
mod references;
mod resume;
mod schedule;
mod significance;

mod damaged;

#[cfg(unix)]
mod corpora;

mod cli;
mod closed;
mod compare;
mod cost;
mod embree_abi;
mod generate;
mod hard;
#[cfg(unix)]
mod limits;
mod made;
mod order;
mod page;
mod pages;
mod plan;
#[cfg(unix)]
mod plan_memory;
mod report_page;
mod rooms;
#[cfg(unix)]
mod spill;
mod texture_files;
mod textures;
#[cfg(unix)]
mod textures_copies;
#[cfg(unix)]
mod textures_faults;
mod watertight;
