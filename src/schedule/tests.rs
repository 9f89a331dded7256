//! Known answers of the schedule room.
