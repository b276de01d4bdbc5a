//! Replies that leave a worker, and payloads that come in, as Zenoh has them.

use std::borrow::Cow;

use domvs_proto::body;
use domvs_proto::messages::ErrorReply;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::Query;

/// Replies on `key`, which is ours: the query's own may be a wildcard, and Zenoh keeps one answer per key.
pub(crate) fn reply_json(query: &Query, key: String, json: &[u8]) {
    log_failure(query.reply(key, json).encoding(body::JSON).wait());
}

/// Reads a JSON body; the door has bounded its size.
pub(crate) fn read_json<T: serde::de::DeserializeOwned>(query: &Query) -> Result<T, ErrorReply> {
    body::read(&contiguous(query.payload())).map_err(|error| ErrorReply::new(error.code(), error))
}

pub(crate) fn contiguous(payload: Option<&ZBytes>) -> Cow<'_, [u8]> {
    payload.map_or(Cow::Borrowed(&[]), ZBytes::to_bytes)
}

pub(crate) fn log_failure(result: zenoh::Result<()>) {
    if let Err(error) = result {
        tracing::debug!(%error, "a reply could not be sent; its client is gone");
    }
}
