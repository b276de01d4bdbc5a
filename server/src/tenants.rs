//! What each client uses of a worker, and what it is let have: messages in a second, messages that wait, bytes.
//!
//! Whoever asks first shows the task's secret, so a client is charged for nothing that another one sends. Creations are the
//! exception: before there is a task there is no secret, so they have an account of their own.

use std::collections::HashMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use domvs_proto::keys::Name;

use crate::Moment;
use crate::config::Limits;
use crate::desk::lock;

/// Names that are remembered at most beyond those that have tasks; newer ones share an account until old ones are forgotten.
const NAMES: usize = 1024;

/// A bucket that fills with tokens at a steady rate and holds those of one second.
#[derive(Debug)]
pub(crate) struct Bucket {
    per_s: f64,
    tokens: f64,
    filled: Moment,
}

/// Of one kind: what is held by one client, or by all.
#[derive(Debug, Default)]
struct Used {
    waiting: AtomicUsize,
    bytes: AtomicUsize,
}

/// One client of this worker.
#[derive(Debug)]
pub(crate) struct Tenant {
    frames: Mutex<Bucket>,
    orders: Mutex<Bucket>,
    controls: Mutex<Bucket>,
    creations: Mutex<Bucket>,
    used: Used,
    all: Arc<Used>,
    limits: Arc<Limits>,
}

/// All clients of this worker.
#[derive(Debug)]
pub(crate) struct Tenants {
    known: Mutex<HashMap<Name, Arc<Tenant>>>,
    /// For names that are one too many.
    crowd: Arc<Tenant>,
    all: Arc<Used>,
    limits: Arc<Limits>,
}

/// What a message or a target takes, given back when it is dropped.
#[derive(Debug)]
pub(crate) struct Held {
    tenant: Arc<Tenant>,
    waiting: usize,
    bytes: usize,
}

/// What somebody does too often, for the account that it is charged to.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Doing {
    /// A frame, asked or pushed.
    Frame,
    /// Settings or target.
    Order,
    /// A control word.
    Control,
    /// Another task.
    Creation,
}

impl Bucket {
    /// A full one; a rate of 0 is none.
    pub(crate) fn new(per_s: usize) -> Bucket {
        let per_s = if per_s == 0 { f64::INFINITY } else { per_s as f64 };
        Bucket { per_s, tokens: per_s, filled: Moment::ZERO }
    }

    /// Takes a token if there is one.
    pub(crate) fn take(&mut self, now: Moment) -> bool {
        self.fill(now);
        let there = self.tokens >= 1.0;
        if there {
            self.tokens -= 1.0;
        }
        there
    }

    fn is_full(&mut self, now: Moment) -> bool {
        self.fill(now);
        self.tokens >= self.per_s
    }

    fn fill(&mut self, now: Moment) {
        if self.per_s.is_infinite() {
            return;
        }
        let since = now.saturating_sub(self.filled).min(Duration::from_secs(1));
        self.tokens = (self.tokens + self.per_s * since.as_secs_f64()).min(self.per_s);
        self.filled = self.filled.max(now);
    }
}

impl Used {
    /// Adds to both counts, or to none if one of them would pass its limit; says which then.
    fn add(&self, [waiting, bytes]: [usize; 2], most: [usize; 2], whose: &str) -> Result<(), String> {
        let within = |used: &AtomicUsize, more: usize, most: usize, what: &str| {
            let before = used.fetch_add(more, Ordering::AcqRel);
            if more == 0 || before.saturating_add(more) <= most {
                return Ok(());
            }
            used.fetch_sub(more, Ordering::AcqRel);
            Err(format!("{whose} may hold {most} {what}, holds {before}, and this is {more} more"))
        };
        within(&self.waiting, waiting, most[0], "waiting messages")?;
        within(&self.bytes, bytes, most[1], "bytes of targets and waiting messages").inspect_err(|_| {
            self.waiting.fetch_sub(waiting, Ordering::AcqRel);
        })
    }

    fn remove(&self, [waiting, bytes]: [usize; 2]) {
        self.waiting.fetch_sub(waiting, Ordering::AcqRel);
        self.bytes.fetch_sub(bytes, Ordering::AcqRel);
    }
}

impl Tenant {
    fn new(limits: &Arc<Limits>, all: &Arc<Used>) -> Tenant {
        let requests = || Mutex::new(Bucket::new(limits.requests_per_s_per_client));
        Tenant {
            frames: Mutex::new(Bucket::new(limits.frames_per_s_per_client)),
            orders: requests(),
            controls: requests(),
            creations: requests(),
            used: Used::default(),
            all: Arc::clone(all),
            limits: Arc::clone(limits),
        }
    }

    /// Whether the client may do this now, or a sentence with the rate that it exceeds.
    pub(crate) fn may(&self, doing: Doing, now: Moment) -> Result<(), String> {
        let (bucket, what, rate) = match doing {
            Doing::Frame => (&self.frames, "frames", self.limits.frames_per_s_per_client),
            Doing::Order => (&self.orders, "requests", self.limits.requests_per_s_per_client),
            Doing::Control => (&self.controls, "control words", self.limits.requests_per_s_per_client),
            Doing::Creation => (&self.creations, "new tasks", self.limits.requests_per_s_per_client),
        };
        match lock(bucket).take(now) {
            true => Ok(()),
            false => Err(format!("a client may send {rate} {what} in a second; this is one too many")),
        }
    }

    /// Counts a message that waits. On an error nothing is held.
    pub(crate) fn hold_message(self: &Arc<Tenant>, bytes: usize) -> Result<Held, String> {
        self.hold(1, bytes)
    }

    /// Counts bytes that are kept. On an error nothing is held.
    pub(crate) fn hold_bytes(self: &Arc<Tenant>, bytes: usize) -> Result<Held, String> {
        self.hold(0, bytes)
    }

    fn hold(self: &Arc<Tenant>, waiting: usize, bytes: usize) -> Result<Held, String> {
        let more = [waiting, bytes];
        self.used.add(more, [self.limits.waiting_per_client, self.limits.bytes_per_client], "a client")?;
        self.all
            .add(more, [self.limits.waiting, self.limits.bytes], "this worker")
            .inspect_err(|_| self.used.remove(more))?;
        Ok(Held { tenant: Arc::clone(self), waiting, bytes })
    }

    fn is_idle(&self, now: Moment) -> bool {
        [&self.frames, &self.orders, &self.controls, &self.creations].iter().all(|bucket| lock(bucket).is_full(now))
    }
}

impl Held {
    /// The message waits no longer, but its bytes are kept.
    pub(crate) fn settled(mut self) -> Held {
        let waited = [std::mem::take(&mut self.waiting), 0];
        self.tenant.used.remove(waited);
        self.tenant.all.remove(waited);
        self
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let less = [self.waiting, self.bytes];
        self.tenant.used.remove(less);
        self.tenant.all.remove(less);
    }
}

impl Tenants {
    pub(crate) fn new(limits: &Limits) -> Tenants {
        let (limits, all) = (Arc::new(limits.clone()), Arc::new(Used::default()));
        Tenants { known: Mutex::default(), crowd: Arc::new(Tenant::new(&limits, &all)), all, limits }
    }

    /// The account of `client`. Names that nobody has seen for long are forgotten; those with tasks never.
    pub(crate) fn of(&self, client: &Name, now: Moment) -> Arc<Tenant> {
        let mut known = lock(&self.known);
        if let Some(tenant) = known.get(client) {
            return Arc::clone(tenant);
        }
        if known.len() >= NAMES + self.limits.tasks {
            known.retain(|_, tenant| Arc::strong_count(tenant) > 1 || !tenant.is_idle(now));
        }
        if known.len() >= NAMES + self.limits.tasks {
            return Arc::clone(&self.crowd);
        }
        let tenant = Arc::new(Tenant::new(&self.limits, &self.all));
        known.insert(client.clone(), Arc::clone(&tenant));
        tenant
    }

    /// Bytes that all targets and waiting messages take.
    pub(crate) fn bytes(&self) -> usize {
        self.all.bytes.load(Ordering::Acquire)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits {
            bytes_per_client: 2000,
            bytes: 3000,
            waiting_per_client: 2,
            waiting: 3,
            frames_per_s_per_client: 10,
            requests_per_s_per_client: 10,
            tasks: 1,
            ..Limits::default()
        }
    }

    fn name(text: &str) -> Name {
        Name::try_from(text).expect("a name")
    }

    #[test]
    fn a_bucket_gives_one_second_at_once_and_then_its_rate() {
        let mut bucket = Bucket::new(10);
        let at = |ms| Duration::from_millis(ms);
        assert_eq!((0..100).filter(|_| bucket.take(at(5000))).count(), 10);
        let later = (0..1000).filter(|ms| bucket.take(at(5000 + ms))).count();
        assert!((9..=10).contains(&later), "{later} in one second");
        assert_eq!(
            (0..100).filter(|_| bucket.take(at(60_000))).count(),
            10,
            "an hour of silence saves no more than one"
        );
        assert!((0..10_000).all(|_| Bucket::new(0).take(at(0))), "0 is no limit");
    }

    #[test]
    fn ten_times_the_rate_gets_the_rate() {
        let tenants = Tenants::new(&limits());
        let tenant = tenants.of(&name("alice"), Duration::ZERO);
        // 100 frames in each of ten seconds, after the burst.
        let let_in = (0..1000).filter(|ms| tenant.may(Doing::Frame, Duration::from_millis(10 * ms)).is_ok()).count();
        assert!((108..=110).contains(&let_in), "{let_in} of 1000");
        assert!(tenant.may(Doing::Control, Duration::ZERO).is_ok(), "frames take no control's place");
    }

    #[test]
    fn what_is_held_is_bounded_for_one_and_for_all_and_given_back() {
        let tenants = Tenants::new(&limits());
        let [alice, bob] = ["alice", "bob"].map(|client| tenants.of(&name(client), Duration::ZERO));
        let first = alice.hold_message(1500).expect("room");
        let error = alice.hold_message(501).expect_err("2001 bytes");
        assert!(error.contains("2000") && error.contains("1500") && error.contains("501"), "{error}");
        let _second = alice.hold_message(500).expect("room");
        let error = alice.hold_message(0).expect_err("a third message");
        assert!(error.contains("may hold 2 waiting"), "{error}");
        let error = bob.hold_bytes(1001).expect_err("3001 of all");
        assert!(error.contains("this worker may hold 3000"), "{error}");
        assert_eq!(tenants.bytes(), 2000, "a refusal holds nothing");
        let first = first.settled();
        let next = alice.hold_message(0).expect("one waits no longer");
        assert_eq!(tenants.bytes(), 2000, "its bytes are kept");
        drop((first, next));
        let _third = bob.hold_bytes(1001).expect("room again");
        assert_eq!(tenants.bytes(), 1501);
    }

    #[test]
    fn any_number_of_names_takes_a_bounded_memory_and_harms_nobody_who_has_a_task() {
        let tenants = Tenants::new(&limits());
        let alice = tenants.of(&name("alice"), Duration::ZERO);
        let held = alice.hold_bytes(7).expect("room");
        for number in 0..20_000 {
            let stranger = tenants.of(&name(&format!("n{number}")), Duration::ZERO);
            let _ = stranger.may(Doing::Creation, Duration::ZERO);
        }
        assert!(lock(&tenants.known).len() <= NAMES + 1);
        assert!(Arc::ptr_eq(&alice, &tenants.of(&name("alice"), Duration::ZERO)));
        let crowd = tenants.of(&name("another"), Duration::ZERO);
        assert!(crowd.may(Doing::Creation, Duration::ZERO).is_err(), "those who are too many share an account");
        let later = tenants.of(&name("another"), Duration::from_secs(2));
        assert!(later.may(Doing::Creation, Duration::from_secs(2)).is_ok(), "idle names are forgotten");
        drop(held);
    }
}
