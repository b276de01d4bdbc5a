//! The service: tasks, pipeline, safety, recording.

pub mod decode;
pub mod record;
