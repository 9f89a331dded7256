//! Panics of other people's decoders, kept from becoming ours: damaged files reach some (B44 in exr
//! 1.74), and a damaged file is one line of error, not the end of a render or a backtrace on the
//! terminal. Never used around our own code, where a panic is a bug to be seen.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `decode`; `None` if it panicked. What it leaves half done must be thrown away with it.
pub(super) fn panics<T>(decode: impl FnOnce() -> T) -> Option<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            // `try_with`: a thread may panic while its locals are being dropped.
            if !QUIET.try_with(Cell::get).unwrap_or(false) {
                before(info);
            }
        }));
    });
    let outer = QUIET.replace(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    QUIET.set(outer);
    result.ok()
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_panic_is_none_and_the_thread_is_loud_again() {
        assert_eq!(super::panics(|| 3), Some(3));
        assert_eq!(super::panics(|| panic!("unseen")), None::<u32>);
        assert!(!super::QUIET.get());
    }
}
