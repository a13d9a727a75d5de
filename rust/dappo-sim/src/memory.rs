//! Whether a request fits the memory, before it is taken: an allocation that fails ends the process.

use std::fs;
use std::path::{Path, PathBuf};

use crate::backend::Layout;
use crate::error::SimError;

/// Bytes of the parts of something, summed up without overflow.
///
/// 128 bits hold the product of any two sizes; what is larger stays the largest number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Bytes(u128);

impl Bytes {
    /// `count` things of `each` bytes.
    #[must_use]
    pub fn of(count: usize, each: usize) -> Self {
        Self(count as u128 * each as u128)
    }

    /// So many times as much.
    #[must_use]
    pub fn times(self, count: usize) -> Self {
        Self(self.0.saturating_mul(count as u128))
    }

    /// The product of two numbers of bytes, of which one is a number of things.
    #[must_use]
    pub fn product(self, other: Self) -> Self {
        Self(self.0.saturating_mul(other.0))
    }

    /// Both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }

    /// Fails if so much memory is not available to this process. `what` begins the error.
    pub fn require(self, what: &str) -> Result<(), SimError> {
        match available() {
            Some(available) if self.0 > u128::from(available) => {
                Err(SimError::Memory { what: what.to_owned(), needed: self.0, available })
            }
            _ => Ok(()),
        }
    }
}

/// What envs take: their states in the backend, their buffers, and the copies that Python makes of them.
#[must_use]
pub fn of_envs(num_envs: usize, layout: &Layout, obs_dim: usize) -> Bytes {
    // Positions, velocities, accelerations and contact forces in double precision, of the state, the step and the
    // solver; observations of the step and of the end of an episode, the copy that is handed out and the space that
    // they are from; and some state of an episode.
    let Layout { nq, nv, nu, nbody, nsensordata, .. } = *layout;
    let state = 3 * 8 * (nq + 4 * nv + nu + 6 * nbody + nsensordata);
    Bytes::of(num_envs, state + 6 * 4 * obs_dim + 3 * 4 * nu + 256)
}

/// Bytes that this process may still take: what the machine has, and what its limits leave. `None` where the
/// operating system does not report it.
fn available() -> Option<u64> {
    [free_memory(), address_space(), control_group()].into_iter().flatten().min()
}

/// The number of kB behind `name:` in a file of `/proc`, in bytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'))?;
    line.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(1024)
}

/// Memory and swap space that the machine can still give.
fn free_memory() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    Some(kilobytes(&text, "MemAvailable")?.saturating_add(kilobytes(&text, "SwapFree").unwrap_or(0)))
}

/// What `ulimit -v` leaves.
fn address_space() -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let limit = soft_limit(&limits, "Max address space")?;
    let used = kilobytes(&fs::read_to_string("/proc/self/status").ok()?, "VmSize")?;
    Some(limit.saturating_sub(used))
}

/// The soft limit of this name in bytes; `None` for unlimited.
fn soft_limit(limits: &str, name: &str) -> Option<u64> {
    limits.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
}

/// What the control groups leave that this process is in, as containers and cluster jobs are.
fn control_group() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let of_version = |root: PathBuf, path: &str, limit: &str, used: &str| -> Option<u64> {
        let group = root.join(path.trim_start_matches('/'));
        // A limit of an outer group holds for the inner ones too.
        group
            .ancestors()
            .take_while(|group| group.starts_with(&root))
            .filter_map(|group| left(group, limit, used))
            .min()
    };
    let root = Path::new("/sys/fs/cgroup");
    groups
        .lines()
        .filter_map(|line| {
            let mut fields = line.splitn(3, ':').skip(1);
            match (fields.next()?, fields.next()?) {
                ("", path) => of_version(root.to_owned(), path, "memory.max", "memory.current"),
                (kinds, path) if kinds.split(',').any(|kind| kind == "memory") => {
                    let (limit, used) = ("memory.limit_in_bytes", "memory.usage_in_bytes");
                    of_version(root.join("memory"), path, limit, used)
                }
                _ => None,
            }
        })
        .min()
}

/// What one control group leaves; what it keeps of files can be given up and does not count as used.
fn left(group: &Path, limit: &str, used: &str) -> Option<u64> {
    let number = |file: &str| fs::read_to_string(group.join(file)).ok()?.trim().parse::<u64>().ok();
    let stat = fs::read_to_string(group.join("memory.stat")).unwrap_or_default();
    let of_files = |name: &str| -> u64 {
        let found = stat.lines().find_map(|line| line.strip_prefix(name)?.trim().parse().ok());
        found.unwrap_or(0)
    };
    let files = of_files("inactive_file ") + of_files("active_file ");
    Some(number(limit)?.saturating_sub(number(used)?.saturating_sub(files)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_beyond_64_bits_are_summed_without_overflow() {
        let most = Bytes::of(usize::MAX, usize::MAX);
        assert!(most.times(usize::MAX).and(most) >= most);
        assert_eq!(Bytes::of(3, 4).times(5).and(Bytes::of(1, 2)), Bytes::of(62, 1));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn what_no_machine_has_is_rejected_with_both_numbers() {
        let message = Bytes::of(1 << 60, 1).require("the envs").unwrap_err().to_string();
        assert!(
            message.starts_with("not enough memory for the envs: about 1.2e9 GB are needed, "),
            "{message}"
        );
        Bytes::of(1, 1).require("a byte").unwrap();
    }

    #[test]
    fn limits_are_read_as_linux_writes_them() {
        let meminfo = "MemTotal:       16384 kB\nMemAvailable:    4096 kB\nSwapFree:           0 kB\n";
        assert_eq!(kilobytes(meminfo, "MemAvailable"), Some(4096 * 1024));
        assert_eq!(kilobytes(meminfo, "Mem"), None);
        let limits = "Limit                     Soft Limit           Hard Limit           Units     \n\
                      Max address space         8192000000           unlimited            bytes     \n\
                      Max cpu time              unlimited            unlimited            seconds   \n";
        assert_eq!(soft_limit(limits, "Max address space"), Some(8_192_000_000));
        assert_eq!(soft_limit(limits, "Max cpu time"), None);
    }
}
