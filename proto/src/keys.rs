//! Key expressions: every key of the service is built and parsed here, and nowhere else.
//!
//! A name is checked before it becomes part of a key, so that no user text can change the routing.

mod names;

pub use self::names::{KeyError, MAX_NAME_BYTES, Name, TaskKey};

/// The last chunk of a task's key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Leaf {
    /// Set or get the target.
    Target,
    /// Ask for a twist with a frame.
    Twist,
    /// Frames pushed by a camera.
    Frame,
    /// Twists for pushed frames.
    Command,
    /// The status messages.
    Status,
    /// Get or patch the settings.
    Settings,
    /// Start, pause, resume, stop, close.
    Control,
    /// What a standby needs.
    State,
}

impl Leaf {
    /// Every leaf.
    pub const ALL: [Leaf; 8] = [
        Leaf::Target,
        Leaf::Twist,
        Leaf::Frame,
        Leaf::Command,
        Leaf::Status,
        Leaf::Settings,
        Leaf::Control,
        Leaf::State,
    ];

    /// The chunk as it stands in the key.
    pub fn as_str(self) -> &'static str {
        match self {
            Leaf::Target => "target",
            Leaf::Twist => "twist",
            Leaf::Frame => "frame",
            Leaf::Command => "command",
            Leaf::Status => "status",
            Leaf::Settings => "settings",
            Leaf::Control => "control",
            Leaf::State => "state",
        }
    }
}

/// All keys under one prefix, `domvs` by default.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Keys {
    prefix: String,
}

impl Default for Keys {
    fn default() -> Keys {
        Keys { prefix: "domvs".to_owned() }
    }
}

impl Keys {
    /// Keys under `prefix`: one name, or several joined by `/`. Fails when a part is not a [`Name`].
    pub fn new(prefix: &str) -> Result<Keys, KeyError> {
        for chunk in prefix.split('/') {
            Name::try_from(chunk)?;
        }
        Ok(Keys { prefix: prefix.to_owned() })
    }

    /// The prefix of every key.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Liveliness token of one worker process.
    pub fn worker_alive(&self, worker: &Name) -> String {
        format!("{}/worker/{worker}/alive", self.prefix)
    }

    /// Every worker's token.
    pub fn workers_alive(&self) -> String {
        format!("{}/worker/*/alive", self.prefix)
    }

    /// Queryable: what a worker is and how busy.
    pub fn worker_info(&self, worker: &Name) -> String {
        format!("{}/worker/{worker}/info", self.prefix)
    }

    /// Every worker's info.
    pub fn workers_info(&self) -> String {
        format!("{}/worker/*/info", self.prefix)
    }

    /// Where `client` asks `worker` for a task.
    pub fn create(&self, worker: &Name, client: &Name) -> String {
        format!("{}/worker/{worker}/create/{client}", self.prefix)
    }

    /// What a worker declares to serve every client's `create`.
    pub fn creates(&self, worker: &Name) -> String {
        format!("{}/worker/{worker}/create/*", self.prefix)
    }

    /// Liveliness token of the one owner of a task.
    pub fn owner(&self, task: &TaskKey, worker: &Name, epoch: u32) -> String {
        format!("{}/task/{task}/owner/{worker}/{epoch}", self.prefix)
    }

    /// Every task's owner token.
    pub fn owners(&self) -> String {
        format!("{}/task/*/*/owner/**", self.prefix)
    }

    /// One task's owner token.
    pub fn owners_of(&self, task: &TaskKey) -> String {
        format!("{}/task/{task}/owner/**", self.prefix)
    }

    /// One task's key by its leaf.
    pub fn task(&self, task: &TaskKey, leaf: Leaf) -> String {
        format!("{}/task/{task}/{}", self.prefix, leaf.as_str())
    }

    /// What a worker declares for a task's leaf: the literal part is the same for all tasks, and the identifier alone tells which.
    pub fn of_any_client(&self, task: &TaskKey, leaf: Leaf) -> String {
        format!("{}/task/*/{}/{}", self.prefix, task.id, leaf.as_str())
    }

    /// Queryable: set or get the target.
    pub fn target(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Target)
    }

    /// Queryable: a frame in, a twist out.
    pub fn twist(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Twist)
    }

    /// Frames pushed by a camera.
    pub fn frame(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Frame)
    }

    /// Twists for pushed frames.
    pub fn command(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Command)
    }

    /// Status messages.
    pub fn status(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Status)
    }

    /// Queryable: get or patch the settings.
    pub fn settings(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Settings)
    }

    /// Queryable: start, pause, resume, stop, close.
    pub fn control(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::Control)
    }

    /// Publisher and queryable: what a standby needs.
    pub fn state(&self, task: &TaskKey) -> String {
        self.task(task, Leaf::State)
    }

    /// Every key of every task: where a worker says that a task is unknown.
    pub fn tasks(&self) -> String {
        format!("{}/task/**", self.prefix)
    }

    /// Every task's key of one leaf, for listing.
    pub fn every(&self, leaf: Leaf) -> String {
        format!("{}/task/*/*/{}", self.prefix, leaf.as_str())
    }

    /// Every task's `command`.
    pub fn commands(&self) -> String {
        self.every(Leaf::Command)
    }

    /// Every task's `status`.
    pub fn statuses(&self) -> String {
        self.every(Leaf::Status)
    }

    /// Liveliness token of a client: its lease.
    pub fn client_alive(&self, client: &Name) -> String {
        format!("{}/client/{client}/alive", self.prefix)
    }

    /// Every client's token.
    pub fn clients_alive(&self) -> String {
        format!("{}/client/*/alive", self.prefix)
    }

    /// Liveliness token of one process of a client: its own lease.
    pub fn process_alive(&self, client: &Name, process: &Name) -> String {
        format!("{}/client/{client}/{process}/alive", self.prefix)
    }

    /// Frames of a camera that speaks this format.
    pub fn camera_frame(&self, camera: &Name) -> String {
        format!("{}/camera/{camera}/frame", self.prefix)
    }

    /// What a camera is: [`crate::messages::CameraInfo`].
    pub fn camera_info(&self, camera: &Name) -> String {
        format!("{}/camera/{camera}/info", self.prefix)
    }

    /// Queryable of simulated cameras: the frame that the camera would send from where it should be.
    pub fn camera_desired(&self, camera: &Name) -> String {
        format!("{}/camera/{camera}/desired", self.prefix)
    }

    /// Liveliness token of a camera.
    pub fn camera_alive(&self, camera: &Name) -> String {
        format!("{}/camera/{camera}/alive", self.prefix)
    }

    /// Every camera's token.
    pub fn cameras_alive(&self) -> String {
        format!("{}/camera/*/alive", self.prefix)
    }

    /// Any payload here stops everything.
    pub fn stop(&self) -> String {
        format!("{}/stop", self.prefix)
    }

    /// `…/worker/<wid>/create/<cid>` → worker and client.
    pub fn parse_create(&self, key: &str) -> Option<(Name, Name)> {
        match self.chunks(key)?.as_slice() {
            ["worker", worker, "create", client] => Some((name(worker)?, name(client)?)),
            _ => None,
        }
    }

    /// `…/worker/<wid>/alive` → worker.
    pub fn parse_worker_alive(&self, key: &str) -> Option<Name> {
        match self.chunks(key)?.as_slice() {
            ["worker", worker, "alive"] => name(worker),
            _ => None,
        }
    }

    /// `…/client/<cid>/alive` → client.
    pub fn parse_client_alive(&self, key: &str) -> Option<Name> {
        match self.chunks(key)?.as_slice() {
            ["client", client, "alive"] => name(client),
            _ => None,
        }
    }

    /// `…/camera/<name>/alive` → camera.
    pub fn parse_camera_alive(&self, key: &str) -> Option<Name> {
        match self.chunks(key)?.as_slice() {
            ["camera", camera, "alive"] => name(camera),
            _ => None,
        }
    }

    /// `…/task/<cid>/<id>/owner/<wid>/<epoch>` → task, worker and epoch.
    pub fn parse_owner(&self, key: &str) -> Option<(TaskKey, Name, u32)> {
        match self.chunks(key)?.as_slice() {
            ["task", client, id, "owner", worker, epoch] => Some((
                task_key(client, id)?,
                name(worker)?,
                epoch.parse::<u32>().ok().filter(|e| e.to_string() == *epoch)?,
            )),
            _ => None,
        }
    }

    /// `…/task/<cid>/<id>/<leaf>` → task and leaf.
    pub fn parse_task(&self, key: &str) -> Option<(TaskKey, Leaf)> {
        match self.chunks(key)?.as_slice() {
            ["task", client, id, last] => {
                let leaf = Leaf::ALL.into_iter().find(|leaf| leaf.as_str() == *last)?;
                Some((task_key(client, id)?, leaf))
            }
            _ => None,
        }
    }

    /// The same as they stand in the key, `<cid>/<id>` not checked: for looking a task up without building anything.
    pub fn split_task<'k>(&self, key: &'k str) -> Option<(&'k str, Leaf)> {
        let (task, last) = key.strip_prefix(&self.prefix)?.strip_prefix("/task/")?.rsplit_once('/')?;
        Some((task, Leaf::ALL.into_iter().find(|leaf| leaf.as_str() == last)?))
    }

    /// The chunks after the prefix; nothing when the key is not under it.
    fn chunks<'k>(&self, key: &'k str) -> Option<Vec<&'k str>> {
        let rest = key.strip_prefix(&self.prefix)?.strip_prefix('/')?;
        Some(rest.split('/').collect())
    }
}

fn name(chunk: &str) -> Option<Name> {
    Name::try_from(chunk).ok()
}

fn task_key(client: &str, id: &str) -> Option<TaskKey> {
    Some(TaskKey { client: name(client)?, id: name(id)? })
}
