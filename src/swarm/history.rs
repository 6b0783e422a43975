//! The past events and applied commands of a swarm, in bounded memory.
//!
//! The thread of the swarm records a command before it replies, so a client finds its command here. The
//! commands are those that a `wait` for an event looks through; the store has all of them.

use std::collections::VecDeque;
use std::sync::Arc;

use parking_lot::Mutex;

use crate::swarm::command::ANNOTATE;
use crate::swarm::frame::{Event, EventKind, Stamp};
use crate::swarm::sender::{Creation, Sender};

/// Limits of the events: their number and bytes.
const MAX_EVENTS: (usize, usize) = (1024, 256 * 1024);

/// The same for those events that are notes: a note evicts only notes.
const MAX_NOTES: (usize, usize) = (MAX_EVENTS.0 / 8, MAX_EVENTS.1 / 8);

/// Limits of the applied commands: their number and bytes.
const MAX_ENTRIES: (usize, usize) = (4096, 256 * 1024);

/// Bytes of a record without its text.
const RECORD_BYTES: usize = 64;

#[derive(Clone, Debug)]
pub struct Entry {
    /// The stamp of the swarm after it; its `seq` numbers the entry.
    pub stamp: Stamp,
    /// The wall-clock time, in seconds since 1970, if known.
    pub unix_secs: Option<f64>,
    pub sender: Arc<Sender>,
}

/// Records after a number, and the range of numbers.
#[derive(Clone, Debug)]
pub struct Page<T> {
    /// Oldest first.
    pub records: Vec<T>,
    /// The number of the oldest record that is kept; of events not that of the creation, if those after it
    /// are missing.
    pub oldest: Option<u64>,
    /// The number of the newest record; 0 before the first.
    pub newest: u64,
}

/// The past events and applied commands of a swarm. The oldest are evicted.
#[derive(Default)]
pub struct History {
    events: Mutex<Events>,
    entries: Mutex<Ring<Entry>>,
}

/// The past events.
#[derive(Default)]
struct Events {
    /// The creation, which stays.
    created: Option<Event>,
    notes: Ring<Event>,
    others: Ring<Event>,
}

impl History {
    /// Adds an event, and the command if it is the event of one.
    pub fn record_event(&self, event: &Event) {
        if let EventKind::Command(sender) = &event.kind {
            self.record_command(Entry {
                stamp: event.stamp.clone(),
                unix_secs: event.unix_secs,
                sender: sender.clone(),
            });
        }
        let bytes = RECORD_BYTES + event.kind.bytes();
        let mut events = self.events.lock();
        match &event.kind {
            EventKind::Created(_) => events.created = Some(event.clone()),
            kind if kind.is_note() => {
                let notes = &mut events.notes;
                notes.push(event.number, bytes, event.clone(), MAX_NOTES);
            }
            _ => {
                let others = &mut events.others;
                others.push(event.number, bytes, event.clone(), MAX_EVENTS);
            }
        }
    }

    /// Adds a command that has no event in this history.
    pub fn record_command(&self, entry: Entry) {
        let bytes = RECORD_BYTES + entry.sender.bytes();
        let number = entry.stamp.seq;
        let mut entries = self.entries.lock();
        match entry.sender.verb {
            ANNOTATE => entries.newest = number,
            _ => entries.push(number, bytes, entry, MAX_ENTRIES),
        }
    }

    /// At most `limit` events after number `after`. Notes may be missing among them, and events between the
    /// creation and the oldest other one.
    pub fn events(&self, after: u64, limit: usize) -> Page<Event> {
        let events = self.events.lock();
        let mut page = events.others.after(after, limit);
        let notes = events.notes.after(after, limit);
        page.records.extend(notes.records);
        page.oldest = page.oldest.into_iter().chain(notes.oldest).min();
        page.newest = page.newest.max(notes.newest);
        if let Some(created) = &events.created {
            page.records
                .extend((created.number > after).then(|| created.clone()));
            // Behind a gap it is not the oldest, so that clients see the gap.
            let is_next = page
                .oldest
                .is_none_or(|oldest| oldest == created.number + 1);
            page.oldest = match is_next {
                true => Some(created.number),
                false => page.oldest,
            };
            page.newest = page.newest.max(created.number);
        }
        page.records.sort_by_key(|event| event.number);
        page.records.truncate(limit);
        page
    }

    /// The `seq` of the newest command; 0 before the first.
    pub fn newest(&self) -> u64 {
        self.entries.lock().newest
    }

    /// At most `limit` commands applied after `seq`.
    pub fn entries(&self, seq: u64, limit: usize) -> Page<Entry> {
        self.entries.lock().after(seq, limit)
    }
}

/// Numbered records within bounds. A panic between two assignments could at worst miscount its bytes.
struct Ring<T> {
    records: VecDeque<(u64, usize, T)>,
    bytes: usize,
    newest: u64,
}

impl<T> Default for Ring<T> {
    fn default() -> Self {
        Ring {
            records: VecDeque::new(),
            bytes: 0,
            newest: 0,
        }
    }
}

impl<T: Clone> Ring<T> {
    fn push(&mut self, number: u64, bytes: usize, record: T, (max, max_bytes): (usize, usize)) {
        self.newest = number;
        self.bytes += bytes;
        self.records.push_back((number, bytes, record));
        // The newest stays even if it alone takes more.
        while self.records.len() > 1 && (self.records.len() > max || self.bytes > max_bytes) {
            if let Some((_, bytes, _)) = self.records.pop_front() {
                self.bytes -= bytes;
            }
        }
    }

    fn after(&self, number: u64, limit: usize) -> Page<T> {
        let first = self.records.partition_point(|(it, ..)| *it <= number);
        let records = self.records.range(first..);
        Page {
            records: records.take(limit).map(|(.., it)| it.clone()).collect(),
            oldest: self.records.front().map(|(number, ..)| *number),
            newest: self.newest,
        }
    }
}

impl EventKind {
    /// Whether it is a note, or the scheduling or rejection of one.
    fn is_note(&self) -> bool {
        match self {
            EventKind::Command(sender)
            | EventKind::Scheduled(_, sender)
            | EventKind::Rejected(sender, _) => sender.verb == ANNOTATE,
            _ => false,
        }
    }

    /// Bytes of its text.
    fn bytes(&self) -> usize {
        match self {
            EventKind::Command(sender)
            | EventKind::Scheduled(_, sender)
            | EventKind::Rejected(sender, _)
            | EventKind::Deleted(sender) => sender.bytes(),
            EventKind::Lapsed(ids) => 4 * ids.len(),
            EventKind::Model { .. } => 8,
            EventKind::Fault(reason) => reason.len(),
            EventKind::RecordingFailed(recording, reason) => recording.len() + reason.len(),
            EventKind::Recorded(what) => what.len(),
            EventKind::Created(creation) => creation.as_ref().map_or(0, |it| it.bytes()),
            EventKind::Phase => 0,
        }
    }
}

impl Sender {
    /// Bytes of its text.
    pub fn bytes(&self) -> usize {
        self.args.len() + length(&self.client) + length(&self.request_id)
    }
}

impl Creation {
    /// Bytes of its text.
    fn bytes(&self) -> usize {
        self.verb.len() + length(&self.client) + length(&self.request_id)
    }
}

fn length(label: &Option<String>) -> usize {
    label.as_ref().map_or(0, String::len)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::swarm::error::SwarmError;
    use crate::swarm::phase::{PauseReason, Phase};

    /// The event of a command with this verb.
    fn event(number: u64, verb: &'static str) -> Event {
        let sender = Sender {
            verb,
            ..Sender::default()
        };
        Event {
            number,
            stamp: Stamp {
                epoch: 1,
                step: 0,
                time: 0.0,
                phase: Phase::Paused(PauseReason::Created),
                seq: number,
            },
            unix_secs: None,
            kind: EventKind::Command(Arc::new(sender)),
        }
    }

    #[test]
    fn notes_evict_only_notes() {
        let history = History::default();
        history.record_event(&event(1, "inform"));
        for number in 2..=2000 {
            history.record_event(&event(number, ANNOTATE));
        }
        let page = history.events(0, 1000);
        assert_eq!(page.records[0].number, 1);
        assert_eq!(page.records[1].number, 2000 - MAX_NOTES.0 as u64 + 1);
        assert_eq!(page.records.last().unwrap().number, 2000);
        assert_eq!((page.oldest, page.newest), (Some(1), 2000));
        let numbers: Vec<u64> = history
            .events(1990, 5)
            .records
            .iter()
            .map(|it| it.number)
            .collect();
        assert_eq!(numbers, [1991, 1992, 1993, 1994, 1995]);
        assert_eq!(history.entries(0, 10).records.len(), 1);
        assert_eq!(history.newest(), 2000);
    }

    #[test]
    fn scheduled_and_rejected_notes_evict_only_notes() {
        let history = History::default();
        history.record_event(&event(1, "inform"));
        for number in 2..=4000 {
            let note = event(number, ANNOTATE);
            let EventKind::Command(sender) = note.kind else {
                unreachable!()
            };
            let kind = match number % 2 {
                0 => EventKind::Scheduled(9, sender),
                _ => EventKind::Rejected(sender, SwarmError::Recorded),
            };
            history.record_event(&Event { kind, ..note });
        }
        assert_eq!(history.events(0, 1).records[0].number, 1);
    }

    #[test]
    fn nothing_evicts_the_creation() {
        let history = History::default();
        let creation = Creation {
            client: Some("olga".to_owned()),
            ..Creation::default()
        };
        let created = Event {
            kind: EventKind::Created(Some(Arc::new(creation))),
            ..event(1, "inform")
        };
        history.record_event(&created);
        assert_eq!(history.events(0, 10).oldest, Some(1));
        history.record_event(&event(2, "inform"));
        assert_eq!(history.events(0, 10).oldest, Some(1));
        for number in 3..=3000 {
            history.record_event(&event(number, "inform"));
        }
        let first_kept = 3000 - MAX_EVENTS.0 as u64 + 1;
        let numbers = |after, limit| -> Vec<u64> {
            let page = history.events(after, limit);
            assert_eq!((page.oldest, page.newest), (Some(first_kept), 3000));
            page.records.iter().map(|it| it.number).collect()
        };
        assert_eq!(numbers(0, 3), [1, first_kept, first_kept + 1]);
        assert_eq!(numbers(0, 5000).len(), MAX_EVENTS.0 + 1);
        assert_eq!(numbers(1, 1), [first_kept]);
    }

    #[test]
    fn the_oldest_are_evicted_by_count_and_by_bytes_and_the_newest_stays() {
        let mut ring = Ring::default();
        for number in 1..=10 {
            ring.push(number, 10, number, (4, 1000));
        }
        let page = ring.after(0, 100);
        assert_eq!(page.records, [7, 8, 9, 10]);
        assert_eq!((page.oldest, page.newest), (Some(7), 10));
        assert_eq!(ring.after(8, 100).records, [9, 10]);
        assert_eq!(ring.after(6, 2).records, [7, 8]);
        assert_eq!(ring.after(10, 2).records, Vec::<u64>::new());
        assert_eq!(ring.after(u64::MAX, 2).newest, 10);
        ring.push(11, 2000, 11, (4, 1000));
        assert_eq!(ring.after(0, 100).records, [11]);
    }
}
