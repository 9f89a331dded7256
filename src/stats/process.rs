//! What the operating system knows of this process, from /proc. Answers "unknown" elsewhere; never
//! guesses.

use std::fs;
use std::time::Instant;

/// Memory that programs can still have without swapping, in bytes; `None` where the system does not
/// say.
#[must_use]
pub fn available_memory_bytes() -> Option<u64> {
    field_kib(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:").map(|kib| kib * 1024)
}

/// Bytes of memory that are resident now (Linux's VmRSS); `None` where it is not told.
#[must_use]
pub fn rss_bytes() -> Option<u64> {
    field_kib(&fs::read_to_string("/proc/self/status").ok()?, "VmRSS:").map(|kib| kib * 1024)
}

/// Most bytes of memory that were ever resident (Linux's VmHWM); `None` where it is not told.
#[must_use]
pub fn peak_rss_bytes() -> Option<u64> {
    field_kib(&fs::read_to_string("/proc/self/status").ok()?, "VmHWM:").map(|kib| kib * 1024)
}

/// Processor seconds that the calling thread has used; `None` where it is not told. Costs a system
/// call or three: for the ends of a worker's life, not for its loop.
#[must_use]
pub fn thread_cpu_seconds() -> Option<f64> {
    // Nanoseconds on a processor come first.
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: u64 = text.split_ascii_whitespace().next()?.parse().ok()?;
    Some(nanoseconds as f64 * 1e-9)
}

/// Nanoseconds since then.
#[must_use]
pub fn nanoseconds(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

fn field_kib(status: &str, name: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_kernels_format() {
        let status = "Name:\tweir\nVmPeak:\t    9000 kB\nVmHWM:\t    1234 kB\nThreads:\t3\n";
        assert_eq!(field_kib(status, "VmHWM:"), Some(1234));
        assert_eq!(field_kib(status, "VmSwap:"), None);
        assert_eq!(field_kib("VmHWM:\tlots\n", "VmHWM:"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn peak_memory_follows_an_allocation() {
        const BYTES: usize = 64 << 20;
        let before = peak_rss_bytes().expect("Linux tells");
        let block = std::hint::black_box(vec![1u8; BYTES]);
        let after = peak_rss_bytes().expect("Linux tells");
        // Other tests' memory may have peaked higher before; then nothing needs to move.
        assert!(after >= before && after as usize >= BYTES, "{before} then {after}");
        drop(block);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn processor_time_passes_while_working_and_not_while_sleeping() {
        let work = || {
            let start = std::time::Instant::now();
            let from = thread_cpu_seconds().expect("Linux tells");
            let mut x = 1u64;
            while start.elapsed().as_millis() < 100 {
                x = std::hint::black_box(x.wrapping_mul(3));
            }
            thread_cpu_seconds().expect("Linux tells") - from
        };
        let used = work();
        // At least a scheduler's tick even on a crowded machine, and never more than the wall clock
        // by more than a tick.
        assert!(used > 0.004 && used < 0.5, "{used} s");
        let from = thread_cpu_seconds().expect("Linux tells");
        std::thread::sleep(std::time::Duration::from_millis(50));
        let slept = thread_cpu_seconds().expect("Linux tells") - from;
        assert!(slept < 0.03, "{slept} s while asleep");
    }
}
