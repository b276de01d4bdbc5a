//! The yardstick of the network: a queryable that answers frames at once, on Zenoh's own receive path, with a twist of zeros that has as
//! many bytes as a real one. It stands where a task would, so that a client asks it in exactly the same way; no pixel is looked at.

use anyhow::Context;
use domvs_proto::frame::FrameHeader;
use domvs_proto::keys::{Keys, Name, TaskKey};
use domvs_proto::status::Status;
use domvs_proto::twist::{TWIST_ENCODING, TwistMessage};
use zenoh::Session;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

/// Whose task the echo pretends to be.
pub const CLIENT: &str = "bench-echo";

/// A running echo; it ends when it is dropped.
pub struct Echo {
    _queryable: Queryable<()>,
    _owner: LivelinessToken,
}

/// The task that the echo of this name stands for.
///
/// # Errors
/// Fails when the name is none.
pub fn task(name: &str) -> anyhow::Result<TaskKey> {
    Ok(TaskKey { client: Name::try_from(CLIENT)?, id: Name::try_from(name)? })
}

impl Echo {
    /// Declares what a client looks for: an owner, and an answer.
    ///
    /// # Errors
    /// Fails when the name is none or the session is closed.
    pub async fn start(session: &Session, keys: &Keys, name: &str) -> anyhow::Result<Echo> {
        let task = task(name)?;
        let queryable = session.declare_queryable(keys.twist(&task)).complete(true).callback(answer).await;
        let token = session.liveliness().declare_token(keys.owner(&task, &task.id, 1)).await;
        let failed = "cannot declare the echo";
        Ok(Echo {
            _queryable: queryable.map_err(anyhow::Error::from_boxed).context(failed)?,
            _owner: token.map_err(anyhow::Error::from_boxed).context(failed)?,
        })
    }
}

/// The frame's own sequence comes back, as the client insists on it.
fn answer(query: Query) {
    let attachment = query.attachment().map(ZBytes::to_bytes);
    let header = FrameHeader::from_attachment(attachment.as_deref());
    let sequence = header.map_or(0, |header| header.sequence);
    let twist = TwistMessage { sequence, epoch: 1, valid_ms: 1, ..TwistMessage::zero(Status::Servoing) };
    let reply = query.reply(query.key_expr().clone(), twist.encode().to_vec()).encoding(Encoding::from(TWIST_ENCODING));
    if let Err(error) = reply.wait() {
        tracing::debug!(%error, "nobody waits for the echo any more");
    }
}
