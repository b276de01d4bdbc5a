//! What waits for one task: a few orders (a stop among them never waits behind another), a few questions that anybody may
//! ask (they take no room of the owner's), a few twist requests, and the newest frame.
//!
//! Zenoh callbacks run on the session's receive path, so they only put things here and return. Nothing blocks
//! and nothing grows: an order or a request that finds its queue full comes back to the caller, a frame
//! replaces the one that waited and the loss is counted. Requests are bounded in bytes as well: all that wait have no more than
//! the largest single one may have.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What [`Mailbox::take`] hands to the compute pool.
#[derive(Debug, PartialEq, Eq)]
pub enum Item<O, R, F> {
    /// Control first, then settings and target: always before images. Questions of anybody in turn with images.
    Order(O),
    /// One twist request.
    Request(R),
    /// The newest pushed frame.
    Frame(F),
}

/// The queues of one task.
#[derive(Debug)]
pub struct Mailbox<O, R, F> {
    depth: usize,
    /// Of all requests together, unless there is only one.
    most_bytes: usize,
    slots: Mutex<Slots<O, R, F>>,
}

#[derive(Debug)]
struct Slots<O, R, F> {
    urgent: VecDeque<O>,
    orders: VecDeque<O>,
    questions: VecDeque<O>,
    /// Each with its bytes.
    requests: VecDeque<(R, usize)>,
    request_bytes: usize,
    frame: Option<F>,
    frame_goes_next: bool,
    question_goes_next: bool,
}

impl<O, R, F> Mailbox<O, R, F> {
    /// A mailbox that holds `depth` urgent orders, `depth` other orders, `depth` questions, `depth` requests of `most_bytes` together and one frame.
    pub fn new(depth: usize, most_bytes: usize) -> Mailbox<O, R, F> {
        let slots = Slots {
            urgent: VecDeque::with_capacity(depth),
            orders: VecDeque::with_capacity(depth),
            questions: VecDeque::with_capacity(depth),
            requests: VecDeque::with_capacity(depth),
            request_bytes: 0,
            frame: None,
            frame_goes_next: false,
            question_goes_next: false,
        };
        Mailbox { depth, most_bytes, slots: Mutex::new(slots) }
    }

    /// Adds an order that goes before all others and has room of its own, or gives it back when even that is full.
    pub fn push_urgent(&self, order: O) -> Result<(), O> {
        push(&mut self.lock().urgent, order, self.depth)
    }

    /// Adds an order, or gives it back when the queue is full.
    pub fn push_order(&self, order: O) -> Result<(), O> {
        push(&mut self.lock().orders, order, self.depth)
    }

    /// Adds a question that anybody may ask, or gives it back when there are too many.
    pub fn push_question(&self, question: O) -> Result<(), O> {
        push(&mut self.lock().questions, question, self.depth)
    }

    /// Adds a twist request of `bytes`, or gives it back when the queue is full.
    pub fn push_request(&self, request: R, bytes: usize) -> Result<(), R> {
        let mut slots = self.lock();
        let together = slots.request_bytes.saturating_add(bytes);
        if !slots.requests.is_empty() && together > self.most_bytes {
            return Err(request);
        }
        push(&mut slots.requests, (request, bytes), self.depth).map_err(|(request, _)| request)?;
        slots.request_bytes = together;
        Ok(())
    }

    /// Puts a frame into its slot and returns the one that nobody will look at: the one that waited, or this one if that `was_taken_later`, as
    /// among copies of old frames.
    pub fn put_frame(&self, frame: F, was_taken_later: impl FnOnce(&F) -> bool) -> Option<F> {
        let mut slots = self.lock();
        match &slots.frame {
            Some(waiting) if was_taken_later(waiting) => Some(frame),
            _ => slots.frame.replace(frame),
        }
    }

    /// The next thing to do: orders first, then requests and the frame in turn, and a question after each.
    pub fn take(&self) -> Option<Item<O, R, F>> {
        let mut slots = self.lock();
        if let Some(order) = slots.urgent.pop_front() {
            return Some(Item::Order(order));
        }
        if let Some(order) = slots.orders.pop_front() {
            return Some(Item::Order(order));
        }
        let no_image = slots.frame.is_none() && slots.requests.is_empty();
        if slots.question_goes_next || no_image {
            slots.question_goes_next = false;
            if let Some(question) = slots.questions.pop_front() {
                return Some(Item::Order(question));
            }
        }
        let frame_first = slots.frame_goes_next || slots.requests.is_empty();
        let item = match slots.frame.take_if(|_| frame_first) {
            Some(frame) => Item::Frame(frame),
            None => {
                let (request, bytes) = slots.requests.pop_front()?;
                slots.request_bytes -= bytes;
                Item::Request(request)
            }
        };
        slots.frame_goes_next = matches!(item, Item::Request(_));
        slots.question_goes_next = true;
        Some(item)
    }

    /// Whether [`Mailbox::take`] would return something.
    pub fn has_items(&self) -> bool {
        let slots = self.lock();
        let orders = [&slots.urgent, &slots.orders, &slots.questions].iter().any(|queue| !queue.is_empty());
        orders || !slots.requests.is_empty() || slots.frame.is_some()
    }

    /// Bytes of all requests that wait.
    pub fn request_bytes(&self) -> usize {
        self.lock().request_bytes
    }

    /// Takes out every image that waits, for a worker that was away too long to use them.
    pub fn discard_images(&self) -> (Vec<R>, Option<F>) {
        let mut slots = self.lock();
        slots.request_bytes = 0;
        (slots.requests.drain(..).map(|(request, _)| request).collect(), slots.frame.take())
    }

    fn lock(&self) -> MutexGuard<'_, Slots<O, R, F>> {
        // No code that can panic runs under this lock, so a poisoned one is still whole.
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn push<T>(queue: &mut VecDeque<T>, item: T, depth: usize) -> Result<(), T> {
    if queue.len() >= depth {
        return Err(item);
    }
    queue.push_back(item);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mailbox() -> Mailbox<&'static str, u32, u32> {
        Mailbox::new(2, 100)
    }

    #[test]
    fn the_newest_frame_replaces_the_one_that_waited() {
        let mailbox = mailbox();
        let put = |frame| mailbox.put_frame(frame, |waiting| *waiting > frame);
        assert_eq!(put(1), None);
        assert_eq!(put(2), Some(1));
        assert_eq!(put(1), Some(1), "a copy of an old one");
        assert_eq!(mailbox.take(), Some(Item::Frame(2)));
        assert_eq!(mailbox.take(), None);
    }

    #[test]
    fn orders_come_first_and_requests_alternate_with_frames() {
        let mailbox = mailbox();
        mailbox.put_frame(10, |_| false);
        mailbox.push_request(1, 10).expect("room");
        mailbox.push_request(2, 10).expect("room");
        mailbox.push_order("stop").expect("room");
        assert_eq!(mailbox.take(), Some(Item::Order("stop")));
        assert_eq!(mailbox.take(), Some(Item::Request(1)));
        assert_eq!(mailbox.take(), Some(Item::Frame(10)));
        assert_eq!(mailbox.take(), Some(Item::Request(2)));
        assert!(!mailbox.has_items());
    }

    #[test]
    fn an_urgent_order_finds_room_and_goes_first_when_the_others_wait() {
        let mailbox = mailbox();
        assert_eq!(
            (mailbox.push_order("get"), mailbox.push_order("set"), mailbox.push_order("get")),
            (Ok(()), Ok(()), Err("get"))
        );
        assert_eq!(mailbox.push_urgent("stop"), Ok(()));
        assert_eq!(mailbox.take(), Some(Item::Order("stop")));
        assert_eq!(mailbox.take(), Some(Item::Order("get")));
    }

    #[test]
    fn questions_of_anybody_take_no_room_of_orders_and_wait_for_one_image_each() {
        let mailbox = mailbox();
        assert_eq!(["a", "b", "c"].map(|question| mailbox.push_question(question)), [Ok(()), Ok(()), Err("c")]);
        mailbox.push_order("set").expect("room of its own");
        mailbox.push_request(1, 1).expect("room");
        mailbox.push_request(2, 1).expect("room");
        let taken = std::array::from_fn(|_| mailbox.take());
        let [set, first, a, second, b, none] = taken;
        assert_eq!([set, a, b], ["set", "a", "b"].map(|order| Some(Item::Order(order))));
        assert_eq!([first, second, none], [Some(Item::Request(1)), Some(Item::Request(2)), None]);
    }

    #[test]
    fn a_full_queue_gives_the_request_back() {
        let mailbox = mailbox();
        assert_eq!(
            (mailbox.push_request(1, 10), mailbox.push_request(2, 10), mailbox.push_request(3, 10)),
            (Ok(()), Ok(()), Err(3))
        );
        mailbox.put_frame(7, |_| false);
        assert_eq!(mailbox.discard_images(), (vec![1, 2], Some(7)));
        assert!(!mailbox.has_items());
    }

    #[test]
    fn large_requests_wait_only_as_far_as_their_bytes_go_and_one_always_does() {
        let mailbox = mailbox();
        assert_eq!((mailbox.push_request(1, 500), mailbox.push_request(2, 1)), (Ok(()), Err(2)));
        assert_eq!(mailbox.take(), Some(Item::Request(1)));
        assert_eq!((mailbox.push_request(3, 60), mailbox.push_request(4, 41)), (Ok(()), Err(4)));
        assert_eq!(mailbox.push_request(5, 40), Ok(()));
        assert_eq!(mailbox.discard_images(), (vec![3, 5], None));
        assert_eq!(mailbox.push_request(6, 100), Ok(()));
    }
}
