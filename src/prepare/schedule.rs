//! Which schedule a render takes, and why.
//!
//! Invariant: the one place that decides it, for `weir plan` and for renders. The picture is the same with any.

use crate::settings::{RenderSettings, Schedule};

/// Where geometry is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Store {
    /// All of it stays.
    Resident,
    /// Large meshes come and go.
    Pages {
        /// Bytes of all pages.
        bytes: u64,
        /// Bytes that they may take.
        room: u64,
    },
}

/// Where pages have room for this part of them or more, a path at a time finds nearly all that it needs, and memory does more
/// for pages than for rays that wait.
const ROOM_FOR_DEPTH: u64 = 12;

/// Whether paths need not wait where pages of `bytes` have `room`.
#[must_use]
pub(super) fn is_roomy(bytes: u64, room: u64) -> bool {
    room.saturating_mul(ROOM_FOR_DEPTH) >= bytes
}

/// The schedule, never [`Schedule::Auto`], and why.
#[must_use]
pub fn choose(settings: &RenderSettings, geometry: Store) -> (Schedule, String) {
    let asked = || "asked for".to_owned();
    match (settings.schedule, geometry) {
        (Schedule::Depth, _) => (Schedule::Depth, asked()),
        (Schedule::Sorted, _) => (Schedule::Sorted, asked()),
        (Schedule::Voxel, Store::Pages { .. }) => (Schedule::Voxel, asked()),
        (Schedule::Voxel, Store::Resident) => {
            (Schedule::Sorted, "voxel was asked for, but all geometry stays in memory".into())
        }
        // What is in flight when time is over is lost, and it is much.
        (Schedule::Auto, Store::Pages { .. }) if settings.time_limit_seconds.is_some() => {
            (Schedule::Depth, "a limit on time wants samples that are done soon".into())
        }
        (Schedule::Auto, Store::Pages { bytes, room }) if !is_roomy(bytes, room) => (
            Schedule::Voxel,
            format!("{bytes} bytes of geometry in room for {room}, less than a {ROOM_FOR_DEPTH}th"),
        ),
        (Schedule::Auto, Store::Pages { bytes, room }) if bytes > room => (
            Schedule::Depth,
            format!(
                "{bytes} bytes of geometry in room for {room}: enough for what paths need one after the other"
            ),
        ),
        (Schedule::Auto, _) => (Schedule::Depth, "all geometry fits in memory".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case() {
        let pages = Store::Pages { bytes: 100, room: 8 };
        let enough = Store::Pages { bytes: 100, room: 9 };
        let roomy = Store::Pages { bytes: 100, room: 100 };
        for (asked, store, timed, wanted) in [
            (Schedule::Auto, Store::Resident, false, Schedule::Depth),
            (Schedule::Auto, pages, false, Schedule::Voxel),
            (Schedule::Auto, pages, true, Schedule::Depth),
            (Schedule::Auto, enough, false, Schedule::Depth),
            (Schedule::Auto, roomy, false, Schedule::Depth),
            (Schedule::Voxel, roomy, true, Schedule::Voxel),
            (Schedule::Voxel, Store::Resident, false, Schedule::Sorted),
            (Schedule::Sorted, pages, true, Schedule::Sorted),
            (Schedule::Depth, pages, false, Schedule::Depth),
        ] {
            let time_limit_seconds = timed.then_some(1.0);
            let settings =
                RenderSettings { schedule: asked, time_limit_seconds, ..RenderSettings::default() };
            assert_eq!(choose(&settings, store).0, wanted, "{asked:?} {store:?} {timed}");
        }
    }
}
