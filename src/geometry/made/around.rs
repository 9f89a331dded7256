//! Which faces are at a vertex.

/// Of each vertex, the faces there, in rising order.
pub struct Around {
    /// Where those of a vertex begin, and those of the last end.
    starts: Vec<u32>,
    faces: Vec<u32>,
}

impl Around {
    /// Of faces whose `corners` are below `vertices`, `sides` each.
    pub fn new(vertices: usize, sides: u32, corners: impl Iterator<Item = u32> + Clone) -> Self {
        let mut starts = vec![0; vertices + 1];
        corners.clone().for_each(|v| starts[v as usize + 1] += 1);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut faces = vec![0; starts[vertices] as usize];
        for (corner, v) in corners.enumerate() {
            let next = &mut next[v as usize];
            faces[*next as usize] = corner as u32 / sides;
            *next += 1;
        }
        Self { starts, faces }
    }

    /// Those at `v`.
    pub fn at(&self, v: u32) -> &[u32] {
        &self.faces[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.starts[..]) + size_of_val(&self.faces[..])
    }
}
