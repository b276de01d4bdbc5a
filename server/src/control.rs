//! What a control word does to a task and its outlet, without a network. Time is an argument.

use domvs_proto::messages::{Control, ErrorReply};
use domvs_proto::status::Status;

use crate::Moment;
use crate::outlet::Outlet;
use crate::task::Task;

/// Whether a task may move after this word that did not before.
pub fn moves(control: Control) -> bool {
    matches!(control, Control::Start | Control::Resume)
}

/// Obeys a word that was received at `received` and says what the status is then. `None`: it would make a task move that stands, and may
/// have waited for the whole process to wake. Then nothing changes: whoever said it knows by now of other things.
///
/// # Errors
/// [`Task::control`].
pub fn obey(
    task: &mut Task,
    outlet: &mut Outlet,
    control: Control,
    received: Moment,
    now: Moment,
) -> Result<Option<Status>, ErrorReply> {
    if moves(control) && !task.is_running() && !outlet.is_awake(received, now) {
        return Ok(None);
    }
    let status = task.control(control)?;
    match control {
        Control::Start | Control::Resume => outlet.halt(None, now),
        Control::Pause => outlet.brake(status, now),
        // Not only braked: an older halt would go on saying why it stood before.
        Control::Stop => outlet.halt(Some(status), now),
        Control::Close => {
            outlet.halt(Some(Status::Stopped), now);
            task.latch(Status::Stopped);
        }
    }
    Ok(Some(status))
}
