//! Hints to the processor.

/// A hint that `lines` cache lines from `place` on will be read. Whether anything is there does not matter.
#[inline(always)]
pub fn prefetch<T>(place: *const T, lines: usize) {
    #[cfg(target_arch = "x86_64")]
    for line in 0..lines {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let at = place.cast::<i8>().wrapping_add(64 * line);
        // SAFETY: prefetching is a hint and valid for any address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(at) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (place, lines);
}
