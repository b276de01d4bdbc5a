//! A router, a service and a client in one process, over TCP on the loopback.

use anyhow::Context;
use domvs_client::{Client, ClientOptions, zenoh_config};
use domvs_server::{ServerConfig, Service};
use zenoh::Session;

use crate::network::open_local_router;

/// Everything but the camera.
pub(crate) struct Lab {
    router: Session,
    service: Service,
    /// Who owns the task.
    pub(crate) client: Client,
    endpoint: String,
}

impl Lab {
    pub(crate) async fn start() -> anyhow::Result<Lab> {
        let (router, endpoint) = open_local_router().await?;
        let config = zenoh_config(None, std::slice::from_ref(&endpoint))?;
        let session = zenoh::open(config).await.map_err(anyhow::Error::from_boxed)?;
        let service = Service::start(ServerConfig::default(), session).await.context("cannot start the service")?;
        let client = Client::connect(ClientOptions::named("demo")?.at(&endpoint)?).await?;
        Ok(Lab { router, service, client, endpoint })
    }

    /// How another session joins.
    pub(crate) fn config(&self) -> anyhow::Result<zenoh::Config> {
        Ok(zenoh_config(None, std::slice::from_ref(&self.endpoint))?)
    }

    /// Ends everything in order; what does not end in order is logged.
    pub(crate) async fn stop(self) {
        if let Err(error) = self.client.close().await {
            tracing::warn!(%error, "the client");
        }
        self.service.shutdown().await;
        if let Err(error) = self.router.close().await {
            tracing::warn!(%error, "the router");
        }
    }
}
