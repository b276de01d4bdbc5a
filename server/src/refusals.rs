//! Refusals: one way out for every error answer. It is counted by its code, said in the log a few times a second at
//! most, and sent.
//!
//! The log says who was refused what: client, task and key as far as the key tells, never a secret, never a payload.

use domvs_proto::body;
use domvs_proto::messages::{ErrorCode, ErrorReply};
use tracing::{error, info, warn};
use zenoh::Wait;
use zenoh::query::Query;

use crate::Moment;
use crate::answers::log_failure;
use crate::metrics::Event;
use crate::worker::Shared;

/// A key in the log: longer ones are cut.
const KEY_CHARACTERS: usize = 200;

/// One line; the level says who should read it. `internal` is a defect, the second group is of limits and of hostile or mistaken
/// strangers: an operator's business; the rest is the client's own.
macro_rules! say {
    ($code:expr, $($field:tt)*) => {
        match $code {
            ErrorCode::Internal => error!($($field)*),
            ErrorCode::Quota | ErrorCode::NotOwner | ErrorCode::TooLarge | ErrorCode::BadName => warn!($($field)*),
            _ => info!($($field)*),
        }
    };
}

impl Shared {
    /// Answers with an error.
    pub(crate) fn refuse(&self, query: &Query, error: &ErrorReply) {
        self.metrics.refused(error.code);
        self.say_refused(query.key_expr().as_str(), error);
        log_failure(query.reply_err(body::write(error)).encoding(body::JSON).wait());
    }

    fn say_refused(&self, key: &str, reply: &ErrorReply) {
        let ErrorReply { code, error } = reply;
        let Some(left_out) = self.refusals.admit(*code as usize, self.now()) else {
            self.metrics.happened(Event::LineLeftOut);
            return;
        };
        let left_out = (left_out > 0).then_some(left_out);
        let task = self.keys.parse_task(key).map(|(task, _)| task);
        let client = match &task {
            Some(task) => Some(task.client.clone()),
            None => self.keys.parse_create(key).map(|(_, client)| client),
        };
        let client = client.as_ref().map(tracing::field::display);
        match &task {
            Some(task) => say!(code, %code, %task, client, left_out, "refused: {error}"),
            None => {
                let key: String = key.chars().take(KEY_CHARACTERS).collect();
                say!(code, %code, key, client, left_out, "refused: {error}");
            }
        }
    }

    /// Says how many refusals the log has not: called by the clock now and then.
    pub(crate) fn say_left_out(&self, now: Moment) {
        for (kind, left_out) in self.refusals.overdue(now) {
            let code = ErrorCode::ALL[kind];
            say!(code, %code, left_out, "refused: further ones, left out here");
        }
    }
}
