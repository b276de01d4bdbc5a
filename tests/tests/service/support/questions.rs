//! Questions as a stranger asks them: any bytes on any key.

use std::time::Instant;

use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use domvs_proto::twist::TwistMessage;
use zenoh::Session;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};

use super::LIMIT;

/// One question.
#[derive(Clone, Debug)]
pub struct Question {
    pub selector: String,
    pub payload: Vec<u8>,
    pub encoding: &'static str,
    pub attachment: Option<Vec<u8>>,
}

/// What came back.
#[derive(Clone, Debug)]
pub enum Answer {
    Good { key: String, payload: Vec<u8>, attachment: Option<Vec<u8>> },
    Refused(ErrorReply),
}

impl Question {
    pub fn on(selector: impl Into<String>) -> Question {
        Question { selector: selector.into(), payload: vec![], encoding: "application/json", attachment: None }
    }

    pub fn with(self, payload: impl Into<Vec<u8>>) -> Question {
        Question { payload: payload.into(), ..self }
    }

    pub fn encoded(self, encoding: &'static str) -> Question {
        Question { encoding, ..self }
    }

    pub fn attached(self, attachment: impl Into<Vec<u8>>) -> Question {
        Question { attachment: Some(attachment.into()), ..self }
    }

    /// The one answer. Asked anew while Zenoh knows of nobody there; a panic when that lasts.
    pub async fn ask(&self, session: &Session) -> Answer {
        let asked = Instant::now();
        loop {
            let mut answers = self.ask_all(session).await;
            if let Some(answer) = answers.pop() {
                assert!(answers.is_empty(), "one question, one answer: {answers:?} and {answer:?}");
                return answer;
            }
            assert!(asked.elapsed() < LIMIT, "no answer on {}", self.selector);
            tokio::task::yield_now().await;
        }
    }

    /// Whatever comes back.
    pub async fn ask_all(&self, session: &Session) -> Vec<Answer> {
        let (hand_over, replies) = flume::unbounded::<Reply>();
        session
            .get(&self.selector)
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            .payload(self.payload.clone())
            .encoding(self.encoding)
            .attachment(self.attachment.clone())
            .timeout(LIMIT)
            .callback(move |reply| {
                // Nobody waits for it any more.
                let _ = hand_over.send(reply);
            })
            .await
            .expect("the session is open");
        let mut answers = vec![];
        while let Ok(reply) = replies.recv_async().await {
            answers.push(Answer::read(reply));
        }
        answers
    }
}

impl Answer {
    fn read(reply: Reply) -> Answer {
        match reply.into_result() {
            Ok(sample) => Answer::Good {
                key: sample.key_expr().to_string(),
                payload: sample.payload().to_bytes().into_owned(),
                attachment: sample.attachment().map(|bytes| bytes.to_bytes().into_owned()),
            },
            Err(error) => {
                let bytes = error.payload().to_bytes();
                Answer::Refused(body::read(&bytes).unwrap_or_else(|_| panic!("not an error body: {bytes:?}")))
            }
        }
    }

    pub fn payload(self) -> Vec<u8> {
        match self {
            Answer::Good { payload, .. } => payload,
            Answer::Refused(error) => panic!("refused: {error}"),
        }
    }

    pub fn json(self) -> serde_json::Value {
        serde_json::from_slice(&self.payload()).expect("JSON")
    }

    pub fn twist(self) -> TwistMessage {
        TwistMessage::decode(&self.payload()).expect("a twist")
    }
}

/// The word of a refusal, or a panic with what came instead.
pub fn code(answer: Answer) -> ErrorCode {
    match answer {
        Answer::Refused(error) => error.code,
        good => panic!("expected a refusal, got {good:?}"),
    }
}
