//! Declarations of the Embree 4.3+ ABI.
