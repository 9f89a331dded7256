//! Rows read in parts against images read whole.
