//! Pages of the commands that were applied to a swarm, read from its stored journal.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::persistence::checkpoints::read_stored;
use crate::persistence::journal_reader::{AppliedInput, AppliedInputs, parse_line};
use crate::persistence::recoveries::Recoveries;
use crate::persistence::writer::COMMAND_KINDS;
use crate::store::{Row, Store, StoreError};
use crate::swarm::history::Entry;
use crate::swarm::journal::{Line, Record};
use crate::swarm::sender::Sender;

/// Lines that one page reads.
const MAX_LINES: u64 = 10_000;

/// Bytes of the commands of one page; its last one may take more.
const MAX_BYTES: usize = 256 * 1024;

/// Bytes of lines that are read at once.
const READ_BYTES: usize = 64 * 1024;

/// Which commands a page has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JournalFilter {
    /// Only those with a higher `seq`.
    pub after: u64,
    /// The most commands.
    pub limit: usize,
    /// Where in the journal the page begins; without it, after the command `after`.
    pub line: Option<u64>,
    /// Only those applied at this step or later.
    pub from_step: Option<u64>,
    /// Only those applied at this step or earlier.
    pub to_step: Option<u64>,
    /// Only this verb.
    pub verb: Option<String>,
    /// Only those of this client, or of each client of this user.
    pub client: Option<String>,
}

impl JournalFilter {
    /// Whether an earlier version could have sent it.
    fn is_of_an_earlier_version(&self) -> bool {
        let JournalFilter {
            after: _,
            limit: _,
            line,
            from_step,
            to_step,
            verb,
            client,
        } = self;
        line.or(*from_step).or(*to_step).is_none() && verb.is_none() && client.is_none()
    }

    /// Whether a page has this command.
    pub fn selects(&self, entry: &Entry) -> bool {
        let client = entry.sender.client.as_deref();
        let is_of = |wanted: &str| {
            let rest = client.and_then(|client| client.strip_prefix(wanted));
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(':'))
        };
        entry.stamp.seq > self.after
            && self.from_step.is_none_or(|step| entry.stamp.step >= step)
            && self.to_step.is_none_or(|step| entry.stamp.step <= step)
            && self.verb.as_ref().is_none_or(|it| entry.sender.verb == it)
            && self.client.as_deref().is_none_or(is_of)
    }
}

/// Commands of a journal.
#[derive(Clone, Debug, Default)]
pub struct JournalPage {
    /// Those that were selected, oldest first.
    pub entries: Vec<Entry>,
    /// The `seq` of the oldest one that is stored.
    pub oldest: Option<u64>,
    /// The line at which the next page begins; `None` after the last line.
    pub next: Option<u64>,
}

/// Reads a page of the commands of a swarm with steps of `dt`. Commands that are not durable yet are not
/// among them.
///
/// # Errors
///
/// Those of any read of the store.
pub fn read_page(
    store: &Store,
    swarm: &str,
    dt: f64,
    filter: &JournalFilter,
) -> Result<JournalPage, StoreError> {
    // Waits for the queued writes. If they fail, the page ends with what is durable.
    let _ = store.commit(Vec::new());
    let (first, last) = store.row_numbers(swarm)?;
    let mut journal = StoredCommands {
        store,
        swarm,
        inputs: AppliedInputs::default(),
        recoveries: Recoveries::new(store, swarm),
        scheduled_before: None,
    };
    let oldest = journal.next_seq(first, last)?.map(|(_, seq)| seq);
    let begin = match filter.line {
        Some(line) => line.max(first),
        None if filter.after == 0 => first,
        None => journal.line_after(filter.after, first, last)?,
    };
    // Clients of earlier versions take an empty page for the end, and do not know `next`.
    let reads_on = filter.is_of_an_earlier_version();
    let mut end = last.min(begin.saturating_add(MAX_LINES - 1));
    let (mut entries, mut bytes, mut line) = (Vec::new(), 0, begin);
    let is_full = |entries: &Vec<Entry>, bytes| entries.len() >= filter.limit || bytes >= MAX_BYTES;
    'page: while line <= end {
        let rows = store.rows_of_kinds(swarm, COMMAND_KINDS, (line, end), READ_BYTES)?;
        line = match rows.last() {
            Some(row) => row.number + 1,
            None => end + 1,
        };
        if reads_on && line > end && entries.is_empty() {
            end = last.min(end.saturating_add(MAX_LINES));
        }
        for row in rows {
            let Some(input) = journal.applied(&row)? else {
                continue;
            };
            let entry = input.entry(dt);
            if filter.selects(&entry) {
                bytes += entry.sender.bytes();
                entries.push(entry);
                if is_full(&entries, bytes) {
                    line = row.number + 1;
                    break 'page;
                }
            }
        }
    }
    Ok(JournalPage {
        entries,
        oldest,
        next: (line <= last).then_some(line),
    })
}

/// The lines of a journal that are commands.
struct StoredCommands<'a> {
    store: &'a Store,
    swarm: &'a str,
    /// Those that have been read.
    inputs: AppliedInputs,
    recoveries: Recoveries<'a>,
    /// Those that were scheduled before the first line, once they are needed.
    scheduled_before: Option<BTreeMap<u64, Arc<Sender>>>,
}

impl StoredCommands<'_> {
    /// The command that a line says was applied. A line that cannot be read says nothing: the journal
    /// is truncated there when the swarm is recovered.
    fn applied(&mut self, row: &Row) -> Result<Option<AppliedInput>, StoreError> {
        let Ok(line) = parse_line(row) else {
            return Ok(None);
        };
        if self.recoveries.took_back(&line)? {
            return Ok(None);
        }
        if let Record::Outcome {
            input,
            seq: Some(_),
            ..
        } = line.record
            && !self.inputs.has(input)
            && let Some(sender) = self.sender_of(input)?
        {
            self.inputs.wait_for(input, sender);
        }
        Ok(self.inputs.read(line))
    }

    /// The command on a line before those that were read.
    fn sender_of(&mut self, input: u64) -> Result<Option<Arc<Sender>>, StoreError> {
        let rows = self
            .store
            .rows_of_kinds(self.swarm, COMMAND_KINDS, (input, input), 1)?;
        if let Some(Ok(Line {
            record: Record::Input { sender, .. },
            ..
        })) = rows.first().map(parse_line)
        {
            return Ok(Some(sender));
        }
        if self.scheduled_before.is_none() {
            self.scheduled_before = Some(self.read_scheduled_before()?);
        }
        let scheduled = self.scheduled_before.as_ref();
        Ok(scheduled.and_then(|it| it.get(&input)).cloned())
    }

    fn read_scheduled_before(&self) -> Result<BTreeMap<u64, Arc<Sender>>, StoreError> {
        let Some(oldest) = self.store.history_from(self.swarm)? else {
            return Ok(BTreeMap::new());
        };
        // One that cannot be read is logged; the commands that it has are then left out.
        let scheduled = read_stored(self.store, self.swarm, oldest.number)
            .map(|checkpoint| checkpoint.scheduled)
            .unwrap_or_default();
        let scheduled = scheduled.into_iter();
        Ok(scheduled.map(|(_, it)| (it.input, it.sender)).collect())
    }

    /// The first line from `first` to `last` that says that a command was applied, and its `seq`.
    fn next_seq(&self, mut first: u64, last: u64) -> Result<Option<(u64, u64)>, StoreError> {
        loop {
            // Most often the first one is.
            let rows = self.store.rows_of_kinds(
                self.swarm,
                COMMAND_KINDS,
                (first, last),
                READ_BYTES / 64,
            )?;
            let Some(end) = rows.last().map(|row| row.number) else {
                return Ok(None);
            };
            for row in &rows {
                if let Ok(Line {
                    record:
                        Record::Input { seq: Some(seq), .. } | Record::Outcome { seq: Some(seq), .. },
                    number,
                    ..
                }) = parse_line(row)
                {
                    return Ok(Some((number, seq)));
                }
            }
            first = end + 1;
        }
    }

    /// The first line of which all later commands have a `seq` above `after`, by binary search.
    fn line_after(&self, after: u64, first: u64, last: u64) -> Result<u64, StoreError> {
        let (mut low, mut high) = (first, last + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            match self.next_seq(middle, high - 1)? {
                Some((line, seq)) if seq <= after => low = line + 1,
                _ => high = middle,
            }
        }
        Ok(low)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;
    use crate::persistence::writer::{record, writes};
    use crate::store::{Checkpoint, Settings, Write};
    use crate::swarm::journal;

    /// A store with a swarm whose first row has the number `first`.
    fn stored(first: u64, records: Vec<Record>) -> (tempfile::TempDir, Store) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), Settings::default(), Box::new(|_| {})).unwrap();
        let create = Write::Create {
            swarm: "a".to_owned(),
            about: Vec::new(),
            first: Checkpoint {
                number: first - 1,
                epoch: 1,
                step: 0,
                body: Vec::new(),
            },
        };
        let lines = records.into_iter().zip(first..).map(|(record, number)| {
            let line = Line {
                number,
                epoch: 1,
                step: 10 * number,
                record,
            };
            writes("a", journal::Entry::Line(line)).remove(0)
        });
        let all: Vec<Write> = std::iter::once(create).chain(lines).collect();
        for part in all.chunks(1000) {
            store.submit(part.to_vec(), None);
        }
        store.commit(Vec::new()).unwrap();
        (folder, store)
    }

    fn input(seq: Option<u64>, verb: &'static str, client: &str) -> Record {
        Record::Input {
            at_step: None,
            sender: Arc::new(Sender {
                verb,
                args: "{}".to_owned(),
                client: Some(client.to_owned()),
                ..Sender::default()
            }),
            seq,
            unix_secs: None,
        }
    }

    fn outcome(input: u64, seq: Option<u64>) -> Record {
        Record::Outcome {
            input,
            seq,
            unix_secs: None,
        }
    }

    /// Reads pages as a client does: until one has no `next`. Returns the numbers of the commands, and
    /// of the pages.
    fn read_all(store: &Store, filter: &JournalFilter) -> (Vec<u64>, usize) {
        let (mut seqs, mut pages, mut filter) = (Vec::new(), 0, filter.clone());
        loop {
            let page = read_page(store, "a", 0.5, &filter).unwrap();
            assert!(page.entries.len() <= filter.limit);
            seqs.extend(page.entries.iter().map(|entry| entry.stamp.seq));
            pages += 1;
            match page.next {
                Some(line) => filter.line = Some(line),
                None => return (seqs, pages),
            }
        }
    }

    fn all(limit: usize) -> JournalFilter {
        JournalFilter {
            limit,
            ..JournalFilter::default()
        }
    }

    #[test]
    fn pages_of_any_size_have_the_commands_in_the_order_in_which_they_were_applied() {
        // Lines 4 to 12; the command on line 4 is executed after that on line 5, one is rejected.
        let records = vec![
            input(None, "inform", "olga:a"),
            input(Some(7), "step", "olga"),
            Record::Hash([1; 32]),
            outcome(4, Some(8)),
            input(None, "set", "olgaline"),
            outcome(8, None),
            input(None, "annotate", "olgaline"),
            outcome(10, Some(9)),
            input(Some(10), "advance", "cleo:x"),
        ];
        let (_folder, store) = stored(4, records);
        for limit in 1..=5 {
            assert_eq!(read_all(&store, &all(limit)).0, [7, 8, 9, 10], "{limit}");
        }
        let page = read_page(&store, "a", 0.5, &all(100)).unwrap();
        assert_eq!((page.oldest, page.next), (Some(7), None));
        let second = &page.entries[1];
        assert_eq!((second.sender.verb, second.stamp.step), ("inform", 70));
        assert_eq!(second.stamp.time, 35.0);
        for after in 0..=11 {
            let expected: Vec<u64> = (7..=10).filter(|seq| *seq > after).collect();
            for limit in [1, 100] {
                let filter = JournalFilter {
                    after,
                    ..all(limit)
                };
                assert_eq!(read_all(&store, &filter).0, expected, "after {after}");
            }
        }
        let seqs = |filter: JournalFilter| read_all(&store, &filter).0;
        let of = |client: &str| JournalFilter {
            client: Some(client.to_owned()),
            ..all(1)
        };
        assert_eq!(seqs(of("olga")), [7, 8]);
        assert_eq!(seqs(of("cleo:x")), [10]);
        assert_eq!(seqs(of("olgaline")), [9]);
        assert_eq!(seqs(of("olg")), [0; 0]);
        assert_eq!(
            seqs(JournalFilter {
                verb: Some("annotate".into()),
                ..all(9)
            }),
            [9]
        );
        assert_eq!(
            seqs(JournalFilter {
                from_step: Some(70),
                to_step: Some(110),
                ..all(9)
            }),
            [8, 9]
        );
        // Lines that do not exist.
        assert_eq!(
            seqs(JournalFilter {
                line: Some(u64::MAX),
                ..all(9)
            }),
            [0; 0]
        );
        assert_eq!(
            seqs(JournalFilter {
                line: Some(0),
                ..all(9)
            }),
            [7, 8, 9, 10]
        );
        assert!(read_page(&store, "b", 0.5, &all(1)).is_err());
    }

    #[test]
    fn a_page_reads_a_bounded_part_of_a_long_journal() {
        // A command every 5,000 lines, and one that all the others precede.
        let mut records = vec![Record::Hash([0; 32]); 24_999];
        for (seq, place) in (1..).zip([4_000, 9_000, 14_000, 19_000]) {
            records[place] = input(Some(seq), "inform", "olga");
        }
        records.push(input(Some(5), "set", "cleo"));
        let (_folder, store) = stored(1, records);
        let set = JournalFilter {
            verb: Some("set".to_owned()),
            ..all(10)
        };
        let page = read_page(&store, "a", 0.5, &set).unwrap();
        assert!(page.entries.is_empty());
        assert_eq!(page.next, Some(MAX_LINES + 1));
        assert_eq!(read_all(&store, &set), (vec![5], 3));
        // A client of an earlier version takes an empty page for the end.
        let late = vec![Record::Hash([0; 32]); 24_999].into_iter();
        let late = late.chain([input(Some(1), "set", "cleo")]).collect();
        let (_late_folder, late) = stored(1, late);
        let page = read_page(&late, "a", 0.5, &all(10)).unwrap();
        assert_eq!((page.entries.len(), page.next), (1, None));
        // The search for a command skips the lines before it.
        for after in 0..5 {
            let filter = JournalFilter { after, ..all(1) };
            let page = read_page(&store, "a", 0.5, &filter).unwrap();
            assert_eq!(page.entries[0].stamp.seq, after + 1);
        }
        assert_eq!(
            read_all(&store, &JournalFilter { after: 4, ..all(1) }),
            (vec![5], 1)
        );
        assert_eq!(
            read_all(&store, &JournalFilter { after: 5, ..all(1) }),
            (vec![], 1)
        );
    }

    #[test]
    fn a_page_ends_before_its_commands_take_too_much() {
        let large = |seq| Record::Input {
            at_step: None,
            sender: Arc::new(Sender {
                verb: "batch",
                args: format!("{{\"commands\":\"{}\"}}", "x".repeat(100_000)),
                ..Sender::default()
            }),
            seq: Some(seq),
            unix_secs: None,
        };
        let (_folder, store) = stored(1, (1..=8).map(large).collect());
        let page = read_page(&store, "a", 0.5, &all(100)).unwrap();
        assert_eq!((page.entries.len(), page.next), (3, Some(4)));
        assert_eq!(read_all(&store, &all(100)), ((1..=8).collect(), 3));
    }

    #[test]
    fn the_kinds_of_commands_are_those_that_are_written() {
        for line in [
            input(None, "set", ""),
            input(Some(1), "annotate", ""),
            outcome(1, None),
        ] {
            assert!(COMMAND_KINDS.contains(&record(&line).0));
        }
        for line in [
            Record::Hash([0; 32]),
            Record::Resumed(2),
            Record::Fault(String::new()),
        ] {
            assert!(!COMMAND_KINDS.contains(&record(&line).0));
        }
    }
}
