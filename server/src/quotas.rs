//! Tasks and pixels: what a client may have, and what all may have. Messages and bytes are counted in `tenants`.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use domvs_proto::keys::{Name, TaskKey};
use domvs_proto::messages::{ErrorCode, ErrorReply, Quotas};
use domvs_proto::settings::TaskSettings;

use crate::desk::{Desk, lock};
use crate::worker::Shared;

type Desks = HashMap<String, Arc<Desk>>;

/// Pixels of the camera that these settings name.
pub(crate) fn pixels(settings: &TaskSettings) -> u64 {
    u64::from(settings.camera.width) * u64::from(settings.camera.height)
}

impl Shared {
    /// Whether `client` may have another task, before anything of it is looked at.
    pub(crate) fn check_tasks(&self, client: &Name) -> Result<(), ErrorReply> {
        self.check_tasks_of(&lock(&self.desks), client)
    }

    /// Whether there is room for a task that is not here.
    pub(crate) fn has_room_for(&self, task: &TaskKey, settings: &TaskSettings) -> bool {
        let desks = lock(&self.desks);
        self.check_tasks_of(&desks, &task.client).and_then(|()| self.check_pixels(&desks, task, settings)).is_ok()
    }

    /// Takes a new task in, if there is room for it and its pixels.
    pub(crate) fn admit(&self, desk: &Arc<Desk>, settings: &TaskSettings) -> Result<(), ErrorReply> {
        let mut desks = lock(&self.desks);
        self.check_tasks_of(&desks, &desk.key.client)?;
        self.check_pixels(&desks, &desk.key, settings)?;
        desks.insert(desk.key.to_string(), Arc::clone(desk));
        Ok(())
    }

    /// Grants a task the pixels of these settings instead of what it had, which is returned.
    pub(crate) fn resize(&self, desk: &Desk, settings: &TaskSettings) -> Result<u64, ErrorReply> {
        let desks = lock(&self.desks);
        self.check_pixels(&desks, &desk.key, settings)?;
        Ok(desk.pixels.swap(pixels(settings), Ordering::AcqRel))
    }

    /// What `info` says of the limits, and of what is used of them.
    pub(crate) fn quotas(&self) -> Quotas {
        let limits = &self.config.limits;
        let pixels_used = lock(&self.desks).values().map(|desk| desk.pixels.load(Ordering::Acquire)).sum();
        Quotas {
            tasks_per_client: limits.tasks_per_client as u64,
            pixels_per_client: limits.pixels_per_client as u64,
            pixels: limits.pixels as u64,
            bytes_per_client: limits.bytes_per_client as u64,
            bytes: limits.bytes as u64,
            waiting_per_client: limits.waiting_per_client as u64,
            waiting: limits.waiting as u64,
            frames_per_s_per_client: limits.frames_per_s_per_client as u64,
            requests_per_s_per_client: limits.requests_per_s_per_client as u64,
            pixels_used,
            bytes_used: self.tenants.bytes() as u64,
        }
    }

    fn check_tasks_of(&self, desks: &Desks, client: &Name) -> Result<(), ErrorReply> {
        let limits = &self.config.limits;
        let quota = |whose: &str, limit: usize| {
            Err(ErrorReply::new(ErrorCode::Quota, format!("{whose} may have {limit} tasks, and has them")))
        };
        if desks.len() >= limits.tasks {
            return quota("this worker", limits.tasks);
        }
        if desks.values().filter(|desk| desk.key.client == *client).count() >= limits.tasks_per_client {
            return quota(&format!("client {client}"), limits.tasks_per_client);
        }
        Ok(())
    }

    fn check_pixels(&self, desks: &Desks, task: &TaskKey, settings: &TaskSettings) -> Result<(), ErrorReply> {
        let (limits, new) = (&self.config.limits, pixels(settings));
        let quota = |error: String| Err(ErrorReply::new(ErrorCode::Quota, error));
        if new > limits.pixels_per_frame as u64 {
            return quota(format!("an image may have {} pixels, the camera has {new}", limits.pixels_per_frame));
        }
        let others = || desks.values().filter(|desk| desk.key != *task);
        let sum = |desks: &mut dyn Iterator<Item = &Arc<Desk>>| -> u64 {
            desks.map(|desk| desk.pixels.load(Ordering::Acquire)).sum()
        };
        let of_client = sum(&mut others().filter(|desk| desk.key.client == task.client));
        let of_all = sum(&mut others());
        for (whose, limit, used) in [
            (format!("the cameras of client {}", task.client), limits.pixels_per_client as u64, of_client),
            ("all cameras of this worker".to_owned(), limits.pixels as u64, of_all),
        ] {
            if used + new > limit {
                return quota(format!(
                    "{whose} may have {limit} pixels together, the others have {used}, this one {new}"
                ));
            }
        }
        Ok(())
    }
}
