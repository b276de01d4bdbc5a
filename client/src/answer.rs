//! One question, one answer, one limit: how every request of this crate waits.
//!
//! Zenoh says "nobody is there", "refused by a router" and "dropped" all in the same way: the answers end empty. Right after a
//! connection that happens even when a worker is there, so requests that may be repeated are asked again until the limit.

use std::time::Duration;

use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::time::{Instant, sleep, timeout_at};
use zenoh::Session;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply, ReplyError};
use zenoh::sample::Sample;

use crate::{ClientError, Silence};

/// More answers than this to one question are not looked at.
const ANSWERS: usize = 16;
/// The pause before an empty answer is asked again.
const PAUSE: Duration = Duration::from_millis(20);
/// How much longer than Zenoh this side waits: Zenoh reports its own timeout.
const GRACE: Duration = Duration::from_millis(100);

/// What Zenoh puts into an error of its own when a limit runs out.
const ZENOH_TIMEOUT: &[u8] = b"Timeout";

/// Both ends of the wait for an answer: what Zenoh calls (never blocks), and what is read.
pub(crate) fn answers<T: Send + 'static>(room: usize) -> (impl Fn(T) + Send + Sync + 'static, flume::Receiver<T>) {
    let (hand_over, answers) = flume::bounded(room);
    let callback = move |answer| {
        // Full: somebody floods us. Closed: nobody waits any more.
        let _ = hand_over.try_send(answer);
    };
    (callback, answers)
}

/// As [`answers`], with room for the few that one question gets.
pub(crate) fn few_answers() -> (impl Fn(Reply) + Send + Sync + 'static, flume::Receiver<Reply>) {
    answers(ANSWERS)
}

/// The first answer that is not an error; else the error; else the kind of silence.
pub(crate) async fn first_good(
    answers: flume::Receiver<Reply>,
    key: &str,
    limit: Duration,
) -> Result<Sample, ClientError> {
    let asked = Instant::now();
    let silent = |reason| ClientError::NoAnswer { key: key.to_owned(), waited: asked.elapsed(), reason };
    let mut refusal = None;
    loop {
        match timeout_at(asked + limit + GRACE, answers.recv_async()).await {
            Ok(Ok(reply)) => match reply.into_result() {
                Ok(sample) => return Ok(sample),
                Err(error) if *error.payload().to_bytes() == *ZENOH_TIMEOUT => {
                    refusal.get_or_insert_with(|| silent(Silence::TimedOut));
                }
                Err(error) => refusal = Some(read_refusal(&error, key)),
            },
            Ok(Err(_ended)) => return Err(refusal.unwrap_or_else(|| silent(Silence::Empty))),
            Err(_late) => return Err(refusal.unwrap_or_else(|| silent(Silence::TimedOut))),
        }
    }
}

fn read_refusal(error: &ReplyError, key: &str) -> ClientError {
    match body::read::<ErrorReply>(&error.payload().to_bytes()) {
        Ok(ErrorReply { code, error, .. }) => ClientError::Refused { key: key.to_owned(), code, error },
        Err(error) => ClientError::bad_answer(key)(&error),
    }
}

/// A request that may be asked again when nobody seems to be there.
pub(crate) struct Request<'a> {
    pub(crate) session: &'a Session,
    pub(crate) key: String,
    pub(crate) payload: ZBytes,
    pub(crate) encoding: Encoding,
    pub(crate) attachment: Option<ZBytes>,
    pub(crate) limit: Duration,
}

impl Request<'_> {
    /// With a JSON body.
    pub(crate) fn json<'a>(
        session: &'a Session,
        key: String,
        message: &impl Serialize,
        limit: Duration,
    ) -> Request<'a> {
        let payload = body::write(message).into();
        Request { session, key, payload, encoding: Encoding::APPLICATION_JSON, attachment: None, limit }
    }

    /// With nothing in it: a question.
    pub(crate) fn empty<'a>(session: &'a Session, key: String, limit: Duration) -> Request<'a> {
        Request { session, key, payload: ZBytes::new(), encoding: Encoding::default(), attachment: None, limit }
    }

    /// Asks until there is an answer, a refusal, a timeout, or the limit has gone by in empty answers. A worker that hands
    /// the task over is no refusal: the next owner is asked.
    pub(crate) async fn ask(&self) -> Result<Sample, ClientError> {
        let deadline = Instant::now() + self.limit;
        loop {
            let answer = self.ask_once(deadline.saturating_duration_since(Instant::now())).await;
            // Nobody is there, or the one who was is just handing the task over.
            let between_owners = matches!(
                answer,
                Err(ClientError::NoAnswer { reason: Silence::Empty, .. }
                    | ClientError::Refused { code: ErrorCode::Superseded, .. })
            );
            if !between_owners || Instant::now() + PAUSE >= deadline {
                return answer;
            }
            sleep(PAUSE).await;
        }
    }

    async fn ask_once(&self, limit: Duration) -> Result<Sample, ClientError> {
        let (callback, answers) = few_answers();
        self.session
            .get(&self.key)
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            .payload(self.payload.clone())
            .encoding(self.encoding.clone())
            .attachment(self.attachment.clone())
            .timeout(limit)
            .callback(callback)
            .await
            .map_err(ClientError::session("asking", &self.key))?;
        first_good(answers, &self.key, limit).await
    }

    /// As [`Request::ask`], with a JSON answer.
    pub(crate) async fn ask_json<T: DeserializeOwned>(&self) -> Result<T, ClientError> {
        let answer = self.ask().await?;
        body::read(&answer.payload().to_bytes()).map_err(|error| ClientError::bad_answer(&self.key)(&error))
    }
}
