//! Which outcomes on the lines of a journal a recovery took back.

use crate::persistence::writer::{INPUT, RESUMED};
use crate::store::{NOTE, Store, StoreError};
use crate::swarm::journal::{Line, Record};

/// Tells which outcomes were taken back: a recovery replays a journal up to its last command, so that
/// the steps after that command, and what was scheduled for them, are executed again in the next epoch.
pub struct Recoveries<'a> {
    store: &'a Store,
    swarm: &'a str,
    /// The lines between which no command was received and no epoch begun.
    searched: Option<(u64, u64)>,
    /// The epoch and the step at which the recovery on the second of these lines went on.
    resumed: Option<(u64, u64)>,
}

impl<'a> Recoveries<'a> {
    pub fn new(store: &'a Store, swarm: &'a str) -> Self {
        Recoveries {
            store,
            swarm,
            searched: None,
            resumed: None,
        }
    }

    /// Whether a line is an outcome that was taken back.
    ///
    /// # Errors
    ///
    /// Those of any read of the store.
    pub fn took_back(&mut self, line: &Line) -> Result<bool, StoreError> {
        if !matches!(line.record, Record::Outcome { .. }) {
            return Ok(false);
        }
        let mut after = line.number;
        loop {
            let until = match self.searched {
                Some((first, until)) if (first..until).contains(&after) => until,
                _ => self.search(after)?,
            };
            match self.resumed {
                // What it took back is at a later step, and each outcome has a command before it.
                Some(resumed) if resumed < (line.epoch, line.step) => return Ok(true),
                Some(_) => after = until,
                None => return Ok(false),
            }
        }
    }

    /// Finds the next command or the next recovery after a line. Returns its line.
    fn search(&mut self, after: u64) -> Result<u64, StoreError> {
        let kinds = [INPUT, NOTE, RESUMED];
        let rows = self
            .store
            .rows_of_kinds(self.swarm, kinds, (after + 1, u64::MAX >> 1), 1)?;
        let next = rows.first();
        let until = next.map_or(u64::MAX, |row| row.number);
        self.searched = Some((after, until));
        let resumed = next.filter(|row| row.kind == RESUMED);
        self.resumed = resumed.map(|row| (row.epoch, row.step));
        Ok(until)
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::Arc;

    use super::*;
    use crate::persistence::writer::writes;
    use crate::store::{Checkpoint, Settings, Write};
    use crate::swarm::journal::Entry;
    use crate::swarm::sender::Sender;

    fn input() -> Record {
        Record::Input {
            at_step: None,
            sender: Arc::new(Sender {
                verb: "set",
                args: "{}".to_owned(),
                ..Sender::default()
            }),
            seq: None,
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

    #[test]
    fn outcomes_after_the_step_at_which_a_recovery_went_on_were_taken_back() {
        let lines = [
            ((1, 0), input(), false),
            ((1, 0), input(), false),
            ((1, 1), outcome(1, Some(1)), false),
            ((1, 2), input(), false),
            ((1, 5), outcome(4, Some(2)), true),
            ((1, 5), Record::Hash([0; 32]), false),
            ((1, 7), outcome(2, None), true),
            ((1, 2), Record::Resumed(2), false),
            ((2, 5), outcome(4, Some(2)), false),
            // The end of a daemon that stored a checkpoint, and a kill soon after.
            ((2, 6), Record::Resumed(3), false),
            ((3, 7), outcome(2, None), true),
            ((3, 6), Record::Resumed(4), false),
            ((4, 7), outcome(2, None), false),
        ];
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), Settings::default(), Box::new(|_| {})).unwrap();
        let mut all = vec![Write::Create {
            swarm: "a".to_owned(),
            about: Vec::new(),
            first: Checkpoint {
                number: 0,
                epoch: 1,
                step: 0,
                body: Vec::new(),
            },
        }];
        let lines: Vec<(Line, bool)> = (1..)
            .zip(lines)
            .map(|(number, ((epoch, step), record, is_taken_back))| {
                let line = Line {
                    number,
                    epoch,
                    step,
                    record,
                };
                (line, is_taken_back)
            })
            .collect();
        for (line, _) in &lines {
            all.extend(writes("a", Entry::Line(line.clone())));
        }
        store.commit(all).unwrap();
        let mut recoveries = Recoveries::new(&store, "a");
        for (line, is_taken_back) in lines.iter().chain(lines.iter().rev()) {
            let took_back = recoveries.took_back(line).unwrap();
            assert_eq!(took_back, *is_taken_back, "line {}", line.number);
        }
    }
}
