//! A rendered image: linear RGB, its place in the full frame, nothing else. Invariant: `pixels` has
//! `width × height` entries, rows from the top. Never encodes or clips.

/// Linear RGB pixels of a crop window inside a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Rows from the top, linear RGB.
    pub pixels: Vec<[f32; 3]>,
    /// Where the left upper pixel stands in the full frame.
    pub origin: (u32, u32),
    /// Size of the full frame in pixels; at least `origin` + size.
    pub full_size: (u32, u32),
}

impl Image {
    /// A black image of the whole frame.
    #[must_use]
    pub fn new(width: u32, height: u32) -> Self {
        Self::cropped((width, height), [0, 0, width, height])
    }

    /// A black image of a crop window `x0, y0, x1, y1` (exclusive) of a frame.
    ///
    /// # Panics
    /// When the window is reversed or leaves the frame: readers and the command line check both.
    #[must_use]
    pub fn cropped(full_size: (u32, u32), crop: [u32; 4]) -> Self {
        let [x0, y0, x1, y1] = crop;
        assert!(x0 <= x1 && y0 <= y1 && x1 <= full_size.0 && y1 <= full_size.1, "crop {crop:?} in frame");
        let (width, height) = (x1 - x0, y1 - y0);
        let pixels = vec![[0.0; 3]; width as usize * height as usize];
        Self { width, height, pixels, origin: (x0, y0), full_size }
    }

    /// A whole frame whose pixels are yet to be put in.
    pub(in crate::film) fn empty(width: u32, height: u32) -> Self {
        Self { width, height, pixels: Vec::new(), origin: (0, 0), full_size: (width, height) }
    }

    /// Index of the pixel in column `x` and row `y` of the crop window.
    #[inline(always)]
    #[must_use]
    pub fn index(&self, x: u32, y: u32) -> usize {
        y as usize * self.width as usize + x as usize
    }

    /// Pixels with a component that is infinite or not a number.
    #[must_use]
    pub fn non_finite_pixels(&self) -> u64 {
        self.pixels.iter().filter(|p| !p.iter().all(|c| c.is_finite())).count() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crop_knows_its_place() {
        let mut image = Image::cropped((10, 8), [2, 3, 7, 5]);
        assert_eq!((image.width, image.height, image.origin), (5, 2, (2, 3)));
        assert_eq!(image.pixels.len(), 10);
        let at = image.index(4, 1);
        image.pixels[at] = [1.0, f32::NAN, 0.0];
        image.pixels[0] = [f32::INFINITY; 3];
        assert_eq!((at, image.non_finite_pixels()), (9, 2));
    }
}
