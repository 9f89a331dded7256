//! Memory that begins and ends on 4 KiB boundaries, as direct reads need it. Grows, never shrinks.

use bytemuck::{Pod, Zeroable};

/// What direct reads are aligned to: no disk or filesystem in use wants more.
pub(super) const BLOCK_BYTES: usize = 4096;

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(4096))]
struct Block([u8; BLOCK_BYTES]);

const _: () = assert!(align_of::<Block>() == BLOCK_BYTES, "direct reads go to aligned memory");

/// Reused bytes; what is in them is left from before.
#[derive(Default)]
pub(super) struct Blocks(Vec<Block>);

impl Blocks {
    /// The first `len` bytes, aligned.
    pub(super) fn bytes_mut(&mut self, len: usize) -> &mut [u8] {
        let blocks = len.div_ceil(BLOCK_BYTES);
        if self.0.len() < blocks {
            // Not `resize`, which would copy what nobody wants.
            self.0 = Vec::new();
            self.0 = bytemuck::allocation::zeroed_vec(blocks);
        }
        &mut bytemuck::cast_slice_mut(&mut self.0)[..len]
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        self.0.capacity() * BLOCK_BYTES
    }
}
