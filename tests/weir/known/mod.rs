//! Scenes whose image is known: by energy conservation, in closed form, or by symmetry. Where a
//! scene has no variance the comparison is exact up to rounding; else `significance` judges.

mod camera;
mod direct;
mod environment;
mod film;
mod furnace;
mod masks;
mod media;
mod placement;
mod shapes;
mod sides;
