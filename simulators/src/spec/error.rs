//! Why a description makes no world.

use std::path::PathBuf;

use domvs_vision::CameraError;

use super::named::named_worlds;
use crate::mesh_file::MeshFileError;
use crate::photograph::PhotographError;
use crate::scene::SceneError;

/// Why a description makes no world.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SpecError {
    /// The text is no TOML, or has a key or a type that is not known.
    #[error("{error}")]
    Toml {
        /// What the reader said, with the line.
        error: Box<toml::de::Error>,
    },
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable {
        /// The file asked for.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No world has this name.
    #[error("no world is called {name:?}, expected one of {}", named_worlds().join(", "))]
    UnknownWorld {
        /// The name asked for.
        name: String,
    },
    /// A number is out of its range.
    #[error("{key}: expected {least} to {most}, got {got}")]
    OutOfRange {
        /// Which.
        key: &'static str,
        /// The least there may be.
        least: f64,
        /// The most there may be.
        most: f64,
        /// What there is.
        got: f64,
    },
    /// A number is not finite.
    #[error("{key}: expected finite numbers, got {got:?}")]
    NotFinite {
        /// Which.
        key: &'static str,
        /// What there is.
        got: Vec<f64>,
    },
    /// Keys are missing, or contradict each other.
    #[error("{key}: expected {expected}, got {got}")]
    Contradiction {
        /// Which.
        key: &'static str,
        /// What would do.
        expected: &'static str,
        /// What there is.
        got: String,
    },
    /// A texture cannot be had.
    #[error("{key}: {source}")]
    Photograph {
        /// Which.
        key: &'static str,
        /// Why.
        source: PhotographError,
    },
    /// A mesh cannot be had.
    #[error("scene.objects.file: {0}")]
    Mesh(#[from] MeshFileError),
    /// The optics are impossible.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The scene is impossible.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Fails unless `least <= got <= most`.
pub(super) fn check(key: &'static str, got: f64, least: f64, most: f64) -> Result<(), SpecError> {
    if (least..=most).contains(&got) { Ok(()) } else { Err(SpecError::OutOfRange { key, least, most, got }) }
}

/// Fails unless all numbers are finite.
pub(super) fn finite(key: &'static str, numbers: &[f64]) -> Result<(), SpecError> {
    if numbers.iter().all(|number| number.is_finite()) {
        return Ok(());
    }
    Err(SpecError::NotFinite { key, got: numbers.to_vec() })
}
