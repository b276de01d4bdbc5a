//! Asking for a twist: one frame, one answer, and what must hold before it may be obeyed.

use std::sync::atomic::Ordering;
use std::time::Duration;

use domvs_proto::status::Status;
use domvs_proto::twist::TwistMessage;
use tokio::time::{Instant, sleep};

use super::Task;
use crate::answer::{few_answers, first_good};
use crate::client::Shared;
use crate::frame::OutgoingFrame;
use crate::workers::owner_of;
use crate::{ClientError, Silence};

/// Missing answers in a row after which the owner is looked for.
const MISSES: u32 = 3;
/// The pause before a question that found nobody is asked again.
const PAUSE: Duration = Duration::from_millis(5);

impl Task {
    /// The twist for this frame, or why there is none; in that case do not move. The next frame asks anew.
    ///
    /// While nobody answers, the same frame is asked again until the twist timeout, which is its deadline too: when a worker dies and
    /// another goes on with the task, that is all the caller notices.
    ///
    /// # Errors
    /// [`ClientError::NoAnswer`] for silence; [`ClientError::OwnerLost`] when after three silences in a row nobody owns the task;
    /// [`ClientError::OlderEpoch`] and [`ClientError::WrongSequence`] for twists that must not be obeyed; [`ClientError::Refused`].
    pub async fn twist(&self, frame: &OutgoingFrame) -> Result<TwistMessage, ClientError> {
        match self.ask_twist(frame).await {
            Err(error) if error.is_silence() => Err(self.count_miss().await.err().unwrap_or(error)),
            answered => {
                self.misses.store(0, Ordering::Relaxed);
                answered
            }
        }
    }

    /// Asks anew while nobody is there, until the limit: the worker may just have died, and another takes the task over.
    async fn ask_twist(&self, frame: &OutgoingFrame) -> Result<TwistMessage, ClientError> {
        let deadline = Instant::now() + self.shared.options.twist_timeout;
        loop {
            let answer = self.ask_once(frame, deadline.saturating_duration_since(Instant::now())).await;
            let between_owners = match &answer {
                Err(ClientError::NoAnswer { reason: Silence::Empty, .. } | ClientError::OlderEpoch { .. }) => true,
                Ok(twist) => matches!(twist.status, Status::OwnerLost | Status::Superseded),
                Err(_) => false,
            };
            if !between_owners || Instant::now() + PAUSE >= deadline {
                return answer;
            }
            sleep(PAUSE).await;
        }
    }

    async fn ask_once(&self, frame: &OutgoingFrame, limit: Duration) -> Result<TwistMessage, ClientError> {
        let key = self.asker.key_expr().as_str();
        let (callback, answers) = few_answers();
        self.asker
            .get()
            .payload(frame.payload().clone())
            .encoding(frame.encoding().clone())
            .attachment(frame.attachment(self.secret.as_ref(), microseconds(limit)))
            .callback(callback)
            .await
            .map_err(ClientError::session("asking for a twist", key))?;
        let answer = first_good(answers, key, limit).await?;
        let twist =
            TwistMessage::decode(&answer.payload().to_bytes()).map_err(|error| ClientError::bad_answer(key)(&error))?;
        self.check_twist(key, twist, frame.header().sequence)
    }

    /// Only the newest owner's twist for this very frame may be obeyed.
    fn check_twist(&self, key: &str, twist: TwistMessage, expected: u64) -> Result<TwistMessage, ClientError> {
        self.epoch.admit(twist.epoch).map_err(|newest| Task::older_epoch(key, newest, twist.epoch))?;
        // Zeros for a frame whose header nobody could read have no sequence to echo.
        let unread = twist.sequence == 0 && !twist.is_servoing();
        if twist.sequence != expected && !unread {
            return Err(ClientError::WrongSequence { key: key.to_owned(), expected, got: twist.sequence });
        }
        Ok(twist)
    }

    /// Counts one silence; after three in a row looks whether anybody owns the task, and takes over a newer epoch.
    async fn count_miss(&self) -> Result<(), ClientError> {
        let misses = self.misses.fetch_add(1, Ordering::Relaxed) + 1;
        if misses < MISSES {
            return Ok(());
        }
        let Shared { session, keys, options, .. } = &*self.shared;
        match owner_of(session, keys, &self.key, options.twist_timeout).await? {
            Some(owner) => {
                self.misses.store(0, Ordering::Relaxed);
                if self.epoch.admit(owner.epoch).is_ok() {
                    tracing::info!(task = %self.key, worker = %owner.worker, epoch = owner.epoch, "the task has an owner");
                }
                Ok(())
            }
            None => Err(ClientError::OwnerLost { task: self.key.clone(), misses }),
        }
    }
}

/// Saturates at over an hour.
fn microseconds(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
