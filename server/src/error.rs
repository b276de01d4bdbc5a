//! Why there is no service.

use std::net::SocketAddr;
use std::path::PathBuf;

use domvs_proto::keys::{KeyError, Name};

use crate::record::RecordError;

/// Why a worker could not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServiceError {
    /// Zenoh refused a declaration.
    #[error("cannot declare the worker's keys: {0}")]
    Zenoh(String),
    /// The prefix is not one.
    #[error(transparent)]
    Prefix(#[from] KeyError),
    /// No thread could be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A live worker has this name, or one whose epochs would be the same.
    #[error("worker {worker} cannot be told from the live worker {rival}: choose another name")]
    NameTaken {
        /// The name that was chosen.
        worker: Name,
        /// Who has it.
        rival: Name,
    },
    /// The state directory cannot be used.
    #[error("cannot use the state directory {folder}: {source}")]
    StateDir {
        /// The folder.
        folder: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The recording could not begin.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Nobody can listen where the metrics should be.
    #[error("cannot serve metrics on {address}: {source}")]
    MetricsAddress {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The metrics contradict each other.
    #[error("cannot make the metrics: {0}")]
    Metrics(#[from] prometheus::Error),
}

impl From<zenoh::Error> for ServiceError {
    fn from(error: zenoh::Error) -> ServiceError {
        ServiceError::Zenoh(error.to_string())
    }
}
