//! What threads did while rendering, by room of the code, in thread-seconds.
//!
//! Invariant: rooms do not overlap; their sum is [`RoomTimes::threads`] times the rendering time, but for what is done before
//! threads begin and after they have ended.

use crate::clock::{Nanoseconds, Room};
use serde::{Deserialize, Serialize};

/// Seconds of all threads together, by room.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RoomTimes {
    /// Threads that rendered: more than compute at a time where some wait for a disk.
    pub threads: usize,
    /// Finding the nearest hits of rays.
    pub trace_closest_s: f64,
    /// Finding out whether anything is in the way of rays.
    pub trace_occlusion_s: f64,
    /// Surfaces, materials, textures in memory, lights, and where paths go on.
    pub shade_s: f64,
    /// Starting camera paths.
    pub camera_s: f64,
    /// Summing samples into the film, and taking the next piece of work.
    pub film_s: f64,
    /// Reading and decoding tiles of textures.
    pub read_textures_s: f64,
    /// Reading and checking pages of geometry.
    pub read_geometry_s: f64,
    /// Making pages of displaced meshes, subdivision surfaces and curves.
    pub make_geometry_s: f64,
    /// Putting rays into queues, taking them out, sorting them, and writing down what came of them; 0 where none wait.
    pub queues_s: f64,
    /// Waiting for a turn, while as many others compute as may: 0 where all threads compute.
    pub turn_s: f64,
    /// Waiting for what another thread reads, for room, for work, or for the others to end.
    pub idle_s: f64,
    /// None of these: threads that begin and end.
    pub other_s: f64,
}

impl RoomTimes {
    /// From what `threads` threads spent.
    #[must_use]
    pub fn new(threads: usize, spent: &Nanoseconds) -> Self {
        let seconds = |room: Room| spent[room as usize] as f64 * 1e-9;
        Self {
            threads,
            trace_closest_s: seconds(Room::TraceClosest),
            trace_occlusion_s: seconds(Room::TraceOcclusion),
            shade_s: seconds(Room::Shade),
            camera_s: seconds(Room::Camera),
            film_s: seconds(Room::Film),
            read_textures_s: seconds(Room::ReadTextures),
            read_geometry_s: seconds(Room::ReadGeometry),
            make_geometry_s: seconds(Room::MakeGeometry),
            queues_s: seconds(Room::Queues),
            turn_s: seconds(Room::Turn),
            idle_s: seconds(Room::Idle),
            other_s: seconds(Room::Other),
        }
    }

    /// Each room: its key in the JSON, what people call it, its seconds.
    #[must_use]
    pub fn named(&self) -> [(&'static str, &'static str, f64); Room::ALL.len()] {
        // Destructured, so that a new room breaks the build until it has a name.
        let Self {
            threads: _,
            trace_closest_s,
            trace_occlusion_s,
            shade_s,
            camera_s,
            film_s,
            read_textures_s,
            read_geometry_s,
            make_geometry_s,
            queues_s,
            turn_s,
            idle_s,
            other_s,
        } = *self;
        [
            ("trace_closest_s", "closest hits", trace_closest_s),
            ("trace_occlusion_s", "occlusion", trace_occlusion_s),
            ("shade_s", "shading", shade_s),
            ("camera_s", "camera rays", camera_s),
            ("film_s", "film", film_s),
            ("read_textures_s", "reading tiles", read_textures_s),
            ("read_geometry_s", "reading pages", read_geometry_s),
            ("make_geometry_s", "making pages", make_geometry_s),
            ("queues_s", "queues", queues_s),
            ("turn_s", "waiting for a turn", turn_s),
            ("idle_s", "idle", idle_s),
            ("other_s", "other", other_s),
        ]
    }

    /// All of it.
    #[must_use]
    pub fn sum(&self) -> f64 {
        self.named().iter().map(|(_, _, seconds)| seconds).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    #[test]
    fn every_room_has_its_own_key() {
        let mut spent = Nanoseconds::default();
        spent.iter_mut().zip(1u64..).for_each(|(s, i)| *s = i * 1_000_000_000);
        let times = RoomTimes::new(3, &spent);
        let json = serde_json::to_value(times).expect("plain data");
        let named = times.named();
        // In the order of their numbers, so that each second is where it was spent.
        for ((key, _, seconds), i) in named.into_iter().zip(1u32..) {
            assert_eq!(seconds, f64::from(i), "{key}");
            assert_eq!(json.get(key).and_then(Value::as_f64), Some(seconds), "{key}");
        }
        assert_eq!(json.as_object().expect("an object").len(), named.len() + 1, "and threads");
        assert_eq!(times.sum(), 78.0);
    }
}
