//! Who a client is, how it reaches the others, and every limit it waits by.

use std::fmt;
use std::time::Duration;

use domvs_proto::keys::{Keys, Name};

use crate::{ClientError, zenoh_config};

/// Who a client is and how long it waits.
#[derive(Clone)]
pub struct ClientOptions {
    /// The first part of every key; `domvs` unless a deployment says otherwise.
    pub prefix: String,
    /// The client's name. Processes may share one; each keeps its own tasks alive.
    pub name: Name,
    /// How to reach the others; see [`zenoh_config`].
    pub zenoh: zenoh::Config,
    /// How long [`crate::Client::connect`] tries. Default 5 s.
    pub connect_limit: Duration,
    /// How long a worker is looked for. Default 2 s.
    pub discovery_limit: Duration,
    /// How long `create`, target, settings and control may take. Default 2 s: a worker prepares its buffers for a target.
    pub request_timeout: Duration,
    /// How long one twist may take; sent to the worker as the deadline. Default 500 ms.
    pub twist_timeout: Duration,
}

impl ClientOptions {
    /// The defaults, under this name, with a router or worker on this machine.
    ///
    /// # Errors
    /// [`ClientError::Key`] when the name is not made of 1 to 64 letters, digits, `_` and `-`.
    pub fn named(name: &str) -> Result<ClientOptions, ClientError> {
        let zenoh = zenoh_config(None, &[])?;
        Ok(ClientOptions {
            prefix: Keys::default().prefix().to_owned(),
            name: Name::try_from(name)?,
            zenoh,
            connect_limit: Duration::from_secs(5),
            discovery_limit: Duration::from_secs(2),
            request_timeout: Duration::from_secs(2),
            twist_timeout: Duration::from_millis(500),
        })
    }

    /// The same, with a router or worker at this endpoint, like `tcp/192.168.1.5:7447`.
    ///
    /// # Errors
    /// [`ClientError::Config`] when it is not an endpoint.
    pub fn at(self, endpoint: &str) -> Result<ClientOptions, ClientError> {
        Ok(ClientOptions { zenoh: zenoh_config(None, &[endpoint.to_owned()])?, ..self })
    }
}

impl fmt::Debug for ClientOptions {
    /// Leaves the Zenoh settings out: they may hold passwords.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ClientOptions")
            .field("prefix", &self.prefix)
            .field("name", &self.name)
            .field("connect_limit", &self.connect_limit)
            .field("discovery_limit", &self.discovery_limit)
            .field("request_timeout", &self.request_timeout)
            .field("twist_timeout", &self.twist_timeout)
            .finish_non_exhaustive()
    }
}
