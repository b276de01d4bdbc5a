//! Which instructions the kernels use: the widest this machine has, found when the program starts.
//!
//! Each kernel is written once, over vectors of whatever length, and compiled for every path; `fearless_simd` chooses at run time. So a
//! default build is as fast as one for this machine alone. Sums are taken in another order on another path: twists agree to rounding.

use std::fmt;

use fearless_simd::{Level, Simd, SimdBase};

/// One set of instructions that this machine has.
#[derive(Debug, Clone, Copy)]
pub struct Path(Level);

impl Path {
    /// The widest one.
    pub fn best() -> Path {
        Path(Level::new())
    }

    /// All of them, the widest first.
    pub fn available() -> Vec<Path> {
        let best = Level::new();
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        let levels = [
            best.as_avx512().map(Simd::level),
            best.as_avx2().map(Simd::level),
            best.as_sse4_2().map(Simd::level),
            best.as_sse2().map(Simd::level),
        ];
        #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
        let levels = [Some(best)];
        levels.into_iter().flatten().map(Path).collect()
    }

    /// The one of this name, if the machine has it.
    pub fn named(word: &str) -> Option<Path> {
        Path::available().into_iter().find(|path| path.word() == word)
    }

    /// `avx512`, `avx2` (with fused multiply-add), `sse4.2`, `sse2`, `neon`, or `fallback`.
    pub fn word(self) -> &'static str {
        match self.0 {
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Avx512(_) => "avx512",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Avx2(_) => "avx2",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Sse4_2(_) => "sse4.2",
            #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
            Level::Sse2(_) => "sse2",
            #[cfg(target_arch = "aarch64")]
            Level::Neon(_) => "neon",
            _ => "fallback",
        }
    }

    /// What `fearless_simd::dispatch!` takes.
    pub(crate) fn level(self) -> Level {
        self.0
    }
}

/// Whether a path has 32 vector registers rather than 16: how many sums a kernel may keep in them.
#[inline(always)]
pub(crate) fn has_many_registers<S: Simd>() -> bool {
    cfg!(target_arch = "aarch64") || S::f32s::LEN == 16
}

impl PartialEq for Path {
    fn eq(&self, other: &Path) -> bool {
        self.word() == other.word()
    }
}

impl Eq for Path {}

impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_path_of_this_machine_has_a_name_of_its_own_that_finds_it() {
        let all = Path::available();
        assert_eq!(all.first(), Some(&Path::best()));
        assert!(all.iter().all(|path| Path::named(path.word()) == Some(*path)));
        assert_eq!(Path::named("mmx"), None);
    }
}
