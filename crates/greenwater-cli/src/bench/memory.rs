//! How much memory the program holds, and the most it held: an allocator that counts what it passes on to the system's.
//!
//! Counted are the bytes asked for, not the pages touched. Where much was asked for and never touched (the dense solver asks for scratch as
//! large as the caches of the machine), [`Gauge`] goes by what the system says is resident.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

/// The system's allocator, with a count.
pub struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

/// Bytes held now.
pub fn held() -> usize {
    HELD.load(Relaxed)
}

/// Forgets what was held before.
pub fn forget_most() {
    MOST.store(held(), Relaxed);
}

/// The most bytes held at once since [`forget_most`].
pub fn most() -> usize {
    MOST.load(Relaxed)
}

/// Measures the peak of a piece of work, from where it is made.
pub struct Gauge {
    held: usize,
    /// Whether the system knows the peak of resident memory since then.
    resident: bool,
}

impl Gauge {
    /// Starts from what is held now.
    pub fn start() -> Self {
        forget_most();
        // Linux forgets the peak of resident memory when it is told to.
        let resident = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        Self { held: held(), resident }
    }

    /// The most bytes since, above those held at the start: as asked for, or as touched where half of that never was.
    pub fn peak(&self) -> usize {
        let asked = most().saturating_sub(self.held);
        // Memory that earlier work gave back may still be resident, and serve again: it counts.
        let touched = Some("VmHWM:").filter(|_| self.resident).and_then(resident).map(|peak| peak.saturating_sub(self.held));
        touched.filter(|&touched| asked > 2 * touched.max(UNSURE)).unwrap_or(asked)
    }
}

/// Below so many bytes what is resident says little: the program itself is. 32 MiB.
const UNSURE: usize = 32 << 20;

/// A line of what Linux says about this process, bytes.
fn resident(key: &str) -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    Some(1024 * line.split_whitespace().nth(1)?.parse::<usize>().ok()?)
}

fn taken(bytes: usize) {
    let now = HELD.fetch_add(bytes, Relaxed) + bytes;
    MOST.fetch_max(now, Relaxed);
}

fn given_back(bytes: usize) {
    HELD.fetch_sub(bytes, Relaxed);
}

// SAFETY: every call goes to `System` with the arguments it came with, and its answer is handed back as it is; the counters touch
// no memory of the allocation and do not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises about `layout` are those that `System` asks for.
        let pointer = unsafe { System.alloc(layout) };
        if !pointer.is_null() {
            taken(layout.size());
        }
        pointer
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as in `alloc`.
        let pointer = unsafe { System.alloc_zeroed(layout) };
        if !pointer.is_null() {
            taken(layout.size());
        }
        pointer
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: `pointer` came from `System` with this `layout`, since all that this allocator gives out does.
        unsafe { System.dealloc(pointer, layout) };
        given_back(layout.size());
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as in `dealloc`; the caller's promises about `size` are those that `System` asks for.
        let moved = unsafe { System.realloc(pointer, layout, size) };
        if !moved.is_null() {
            // Old and new may both exist while the contents move.
            taken(size);
            given_back(layout.size());
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Other tests allocate at the same time: far less than this block.
    #[test]
    fn a_block_counts_while_it_lives_and_its_peak_stays_known() {
        const BLOCK: usize = 1 << 30;
        let before = held();
        let gauge = Gauge::start();
        let block: Vec<u8> = Vec::with_capacity(BLOCK);
        assert!(held() >= before + BLOCK / 2);
        drop(block);
        assert!(held() < before + BLOCK / 2);
        assert!(most() >= before + BLOCK / 2);
        // The block was never touched.
        if gauge.resident {
            assert!(gauge.peak() < BLOCK / 2, "{}", gauge.peak());
        }
    }
}
