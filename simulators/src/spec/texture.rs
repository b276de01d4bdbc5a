//! Pictures by name, seed or file.

use std::path::Path;

use super::error::SpecError;
use crate::photograph::Photograph;

/// Side of seeded noise, px.
const NOISE_PX: usize = 512;

/// A bundled photograph, noise of `seed`, or a file in `folder`; `key` is what errors are about.
pub(super) fn photograph(key: &'static str, name: &str, seed: u64, folder: &Path) -> Result<Photograph, SpecError> {
    let photograph = if name == "noise" {
        Ok(Photograph::noise(NOISE_PX, seed))
    } else if Path::new(name).extension().is_none() {
        // No file: a wrong name is answered with the list of the right ones.
        Photograph::bundled(name)
    } else {
        Photograph::open(folder.join(name))
    };
    photograph.map_err(|source| SpecError::Photograph { key, source })
}
