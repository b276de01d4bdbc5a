//! Waiting until somebody is there: Zenoh learns of subscribers and queryables a moment after it connects.

use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use zenoh::handlers::FifoChannelHandler;
use zenoh::matching::{MatchingListener, MatchingStatus};
use zenoh::pubsub::Publisher;
use zenoh::query::Querier;

use crate::ClientError;

/// Whether someone subscribes to what this publishes, now or within `limit`.
pub(crate) async fn has_subscriber(publisher: &Publisher<'_>, limit: Duration) -> Result<bool, ClientError> {
    let failed = || ClientError::session("looking for subscribers", publisher.key_expr().as_str());
    // The listener first: a change between the two is then not missed.
    let changes = publisher.matching_listener().await.map_err(failed())?;
    let status = publisher.matching_status().await.map_err(failed())?;
    Ok(status.matching() || becomes_true(&changes, limit).await)
}

/// Whether someone answers what this asks, now or within `limit`.
pub(crate) async fn has_queryable(querier: &Querier<'_>, limit: Duration) -> Result<bool, ClientError> {
    let failed = || ClientError::session("looking for an answerer", querier.key_expr().as_str());
    let changes = querier.matching_listener().await.map_err(failed())?;
    let status = querier.matching_status().await.map_err(failed())?;
    Ok(status.matching() || becomes_true(&changes, limit).await)
}

async fn becomes_true(changes: &MatchingListener<FifoChannelHandler<MatchingStatus>>, limit: Duration) -> bool {
    let deadline = Instant::now() + limit;
    while let Ok(Ok(status)) = timeout_at(deadline, changes.recv_async()).await {
        if status.matching() {
            return true;
        }
    }
    false
}
