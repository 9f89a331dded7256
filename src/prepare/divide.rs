//! How one number of bytes is divided among geometry, textures, rays that wait, film and tables.
//!
//! Invariant: the parts together never exceed the whole; what a person gives to a part is the most that it gets.
//! Never measures: it divides what is expected, and who loads holds that against what comes.

use super::bytes::GeometryBytes;
use super::schedule::is_roomy;
use crate::error::{Error, Result};
use crate::settings::{Backend, RenderSettings, Schedule};

/// The least that parts of a render work with, and what they take where nothing is said; told by the rooms that know.
pub trait Least {
    /// Bytes of a page of geometry.
    fn page_bytes(&self) -> u64;
    /// Bytes of pages, where threads read beside those that compute, or not.
    fn pages(&self, reading: bool) -> u64;
    /// Bytes of textures, likewise.
    fn textures(&self, reading: bool) -> u64;
    /// Bytes of rays that wait.
    fn rays(&self) -> u64;
    /// Bytes of rays that wait where nobody says.
    fn usual_rays(&self) -> u64;
    /// Bytes of textures where nobody says.
    fn usual_textures(&self) -> u64;
}

/// What each part may take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Division {
    /// What traverses.
    pub backend: Backend,
    /// Geometry and its acceleration structures; `None` where nothing bounds them.
    pub geometry: Option<u64>,
    /// Whether large meshes come and go.
    pub pages: bool,
    /// Textures.
    pub textures: u64,
    /// Rays, where they wait.
    pub rays: u64,
    /// Whether those are set aside.
    pub waiting: bool,
    /// Tables of what waits and of what comes and goes.
    pub tables: u64,
    /// Geometry and textures may give each other of theirs while rendering.
    pub balanced: bool,
    /// How it was done.
    pub because: String,
}

/// Rays that wait take an eighth of what is not bound, up to what they take where nobody says.
const RAYS_SHARE: u64 = 8;
/// Textures are worth coming and going before geometry does, down to a sixteenth of them: a look-up seldom needs the finest
/// level (generated cities and scene b of the benchmarks read an eighteenth to a fiftieth of their texels), and geometry
/// that comes and goes costs time even while it is there.
const TEXTURES_SHARE: u64 = 16;
/// Geometry stays where it takes no more than this part of what is not fixed.
const SMALL_SHARE: u64 = 4;
/// Textures begin with this part of what is free, where geometry comes and goes.
const TEXTURES_BEGIN: u64 = 8;
/// Of tables: the grid and its queues; places of pages in it; where tiles are in their files, some 20 bytes for one of 4 KiB
/// or more.
const TABLES: u64 = 1 << 20;
const TABLES_A_PAGE: u64 = 64;
const TEXTURES_A_TABLE_BYTE: u64 = 200;

/// Divides memory among the parts. `fixed` is what they all leave: film, lights, the scene's tables;
/// `textures` are the bytes of all of them.
///
/// # Errors
/// [`Error::Usage`] where it is too small, with the number that would do.
pub fn divide(
    settings: &RenderSettings,
    fixed: [u64; 3],
    textures: u64,
    geometry: &dyn Fn(Backend) -> GeometryBytes,
    least: &dyn Least,
) -> Result<Division> {
    let Some(memory) = settings.memory else {
        return Ok(without_bound(settings, geometry(settings.backend), least));
    };
    let fixed = fixed.into_iter().fold(0, u64::saturating_add);
    let mut backends = vec![settings.backend];
    if !settings.backend_named && settings.backend != Backend::Native {
        backends.push(Backend::Native);
    }
    let mut would_do = u64::MAX;
    for &backend in &backends {
        let parts = Parts { settings, memory, fixed, textures, backend, geometry: geometry(backend), least };
        match parts.resident() {
            Ok(mut division) => {
                if backend != settings.backend {
                    division.because += "; the native backend, whose trees are smaller";
                }
                return Ok(division);
            }
            Err(needed) => would_do = would_do.min(needed),
        }
    }
    if backends.contains(&Backend::Native) {
        let (backend, geometry) = (Backend::Native, geometry(Backend::Native));
        let parts = Parts { settings, memory, fixed, textures, backend, geometry, least };
        match parts.paged() {
            Ok(mut division) => {
                if settings.backend != Backend::Native {
                    division.because +=
                        "; the native backend, since Embree cannot let go of a part of a scene";
                }
                return Ok(division);
            }
            Err(needed) => would_do = would_do.min(needed),
        }
        let what =
            "film, lights, the scene's tables, and the least that geometry, textures and rays work with";
        return Err(too_small(memory, would_do, what));
    }
    if let (Some(given), u64::MAX) = (settings.geometry_memory, would_do) {
        let whole = geometry(settings.backend).whole_most;
        return Err(Error::Usage(format!(
            "a geometry memory of {given} bytes is too small: --geometry-memory {whole} would do, since with Embree all \
             geometry stays; --backend native lets it come and go"
        )));
    }
    let what = "with Embree all geometry stays; --backend native lets it come and go";
    Err(too_small(memory, would_do, what))
}

/// The one line that refuses.
fn too_small(memory: u64, would_do: u64, what: &str) -> Error {
    Error::Usage(format!("a memory of {memory} bytes is too small: --memory {would_do} would do ({what})"))
}

fn without_bound(settings: &RenderSettings, geometry: GeometryBytes, least: &dyn Least) -> Division {
    let pages = settings.geometry_memory.is_some_and(|budget| geometry.whole_most > budget);
    Division {
        backend: settings.backend,
        geometry: settings.geometry_memory,
        pages,
        textures: settings.texture_memory.unwrap_or_else(|| least.usual_textures()),
        rays: settings.ray_memory.unwrap_or_else(|| least.usual_rays()),
        waiting: false,
        tables: 0,
        balanced: false,
        because: "no bound on all".to_owned(),
    }
}

struct Parts<'a> {
    settings: &'a RenderSettings,
    memory: u64,
    fixed: u64,
    textures: u64,
    backend: Backend,
    geometry: GeometryBytes,
    least: &'a dyn Least,
}

impl Parts<'_> {
    /// What rays that wait get of what is `free`, beyond their `least`.
    fn more_rays(&self, free: u64, least: u64) -> u64 {
        match self.settings.ray_memory {
            Some(_) => 0,
            None => (free / RAYS_SHARE).min(self.least.usual_rays().saturating_sub(least)),
        }
    }

    /// All geometry stays; textures get the rest. Else how much would do.
    fn resident(&self) -> std::result::Result<Division, u64> {
        let RenderSettings { schedule, geometry_memory, texture_memory, ray_memory, .. } = *self.settings;
        let waiting = matches!(schedule, Schedule::Sorted | Schedule::Voxel);
        let GeometryBytes { whole_most: geometry, building, .. } = self.geometry;
        if geometry_memory.is_some_and(|given| geometry > given) {
            return Err(u64::MAX);
        }
        let least_rays = if waiting { ray_memory.unwrap_or_else(|| self.least.rays()) } else { 0 };
        let tables = if waiting { TABLES } else { 0 } + self.textures / TEXTURES_A_TABLE_BYTE;
        let beside = self.fixed + geometry + tables + least_rays;
        // Geometry that is small beside what there is stays whatever textures then get.
        let is_small = geometry <= self.memory.saturating_sub(self.fixed) / SMALL_SHARE;
        let share = if is_small { 0 } else { self.textures / TEXTURES_SHARE };
        // Where triangles are guessed they may have to come and go after all.
        let may_wait = waiting || !self.geometry.exact;
        let least_textures = self.least.textures(may_wait);
        let least =
            texture_memory.unwrap_or(least_textures.max(share).min(self.textures.max(least_textures)));
        // What is whole is there before trees are built; tiles come afterwards, when that memory is free again.
        let needed = (beside + least).max(beside + building + least.min(least_textures));
        if needed > self.memory {
            return Err(needed);
        }
        let left = self.memory - beside;
        let more_rays = if waiting { self.more_rays(left - least, least_rays) } else { 0 };
        let left = left - more_rays;
        let textures = match texture_memory {
            Some(given) => given,
            // What geometry comes to is not known: it gets the rest.
            None if !self.geometry.exact => left.min(self.textures.max(least)),
            None if left >= self.textures + building => left,
            None => left.min(self.textures.saturating_sub(1)).max(least),
        };
        let all = textures >= self.textures;
        Ok(Division {
            backend: self.backend,
            geometry: Some(match geometry_memory {
                Some(given) => given.min(self.memory - self.fixed),
                None if self.geometry.exact => geometry,
                None => geometry + (left - textures.min(left)),
            }),
            pages: false,
            textures,
            rays: if waiting {
                least_rays + more_rays
            } else {
                ray_memory.unwrap_or(self.least.usual_rays())
            },
            waiting,
            tables,
            balanced: false,
            because: if all { "everything fits" } else { "geometry fits, textures come and go in the rest" }
                .to_owned(),
        })
    }

    /// Geometry comes and goes.
    fn paged(&self) -> std::result::Result<Division, u64> {
        let timed = self.settings.time_limit_seconds.is_some();
        match self.settings.schedule {
            Schedule::Depth => self.paged_where(false),
            Schedule::Auto if timed => self.paged_where(false),
            Schedule::Sorted | Schedule::Voxel => self.paged_where(true),
            // What rays need not is room for pages.
            Schedule::Auto => {
                let room = |d: &Division| d.geometry.unwrap_or(0).saturating_sub(self.geometry.staying);
                let roomy = |d: &Division| is_roomy(self.geometry.pages, room(d));
                self.paged_where(false).ok().filter(roomy).map_or_else(|| self.paged_where(true), Ok)
            }
        }
    }

    /// Geometry comes and goes, and rays are `waiting` for it or not.
    fn paged_where(&self, waiting: bool) -> std::result::Result<Division, u64> {
        let RenderSettings { geometry_memory, texture_memory, ray_memory, .. } = *self.settings;
        let pages = self.geometry.pages / self.least.page_bytes().max(1);
        let tables = TABLES + pages * TABLES_A_PAGE + self.textures / TEXTURES_A_TABLE_BYTE;
        // What stays is expected, not known: a sixteenth more, and some for small trees.
        let staying = self.geometry.staying + self.geometry.staying / 16 + (64 << 10);
        let least_geometry = geometry_memory.unwrap_or(staying + self.least.pages(true));
        let least_textures = texture_memory.unwrap_or_else(|| self.least.textures(true));
        let least_rays = match (waiting, ray_memory) {
            (true, given) => given.unwrap_or_else(|| self.least.rays()),
            (false, _) => 0,
        };
        let least = self.fixed + tables + least_geometry + least_textures + least_rays;
        let built = self.fixed + staying + self.geometry.building_staying + least_textures;
        let Some(free) = self.memory.checked_sub(least).filter(|_| built <= self.memory) else {
            return Err(least.max(built));
        };
        let rays = if waiting { self.more_rays(free, least_rays) } else { 0 };
        let free = free - rays;
        // Textures begin with little: look-ups seldom need the finest levels of all that there are, and what they do need
        // they get while rendering, which is harder to take back from them than from geometry.
        let whole_textures = self.textures.saturating_sub(least_textures);
        let whole_geometry =
            (staying + self.geometry.pages + self.geometry.pages / 16).saturating_sub(least_geometry);
        let (to_geometry, to_textures) = match (geometry_memory, texture_memory) {
            (Some(_), Some(_)) => (0, 0),
            (Some(_), None) => (0, free.min(whole_textures)),
            (None, Some(_)) => (free.min(whole_geometry), 0),
            // Of what may come otherwise than is expected: each byte more is one for geometry.
            (None, None) if !self.geometry.exact => (free, 0),
            (None, None) => {
                let begin = free.saturating_sub(whole_geometry).max(free / TEXTURES_BEGIN);
                let to_textures = begin.min(whole_textures);
                (free - to_textures, to_textures)
            }
        };
        Ok(Division {
            backend: self.backend,
            geometry: Some(least_geometry + to_geometry),
            pages: true,
            textures: least_textures + to_textures,
            rays: if waiting { least_rays + rays } else { ray_memory.unwrap_or(self.least.usual_rays()) },
            waiting,
            tables,
            balanced: geometry_memory.is_none() && texture_memory.is_none(),
            because: format!(
                "film, tables and the least of each first; of the rest {}an eighth to textures at first, and the others to \
                 geometry",
                if waiting { "an eighth to rays, " } else { "" }
            ),
        })
    }
}
