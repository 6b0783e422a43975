//! What one step remembers for the next: who pushed, and how hard.

use super::contact::Contact;
use crate::model::{Remembered, SolverMemory};

/// How many contacts a pair can have: one for each code.
const MOST_OF_A_PAIR: usize = 8;

/// Guesses the multipliers of `contacts` from the last step's.
///
/// A contact not seen before, of a pair that was in contact, inherits from one of the pair's
/// contacts that shares an end and is gone: the contact has passed from a side to a cap.
pub fn recall(memory: &SolverMemory, id: &[u32], contacts: &[Contact], guess: &mut Vec<f64>) {
    guess.clear();
    guess.resize(contacts.len(), 0.0);
    // Both lists are ordered by pair, ids being ordered as indices are.
    let mut remembered = &memory.contacts[..];
    let mut start = 0;
    while start < contacts.len() && !remembered.is_empty() {
        let Contact { i, j, .. } = contacts[start];
        let mut end = start + 1;
        while end < contacts.len() && (contacts[end].i, contacts[end].j) == (i, j) {
            end += 1;
        }
        let pair = (id[i as usize], id[j as usize]);
        let skipped = count_while(remembered, |old| (old.first, old.second) < pair);
        remembered = &remembered[skipped..];
        let known = count_while(remembered, |old| (old.first, old.second) == pair);
        inherit(
            &remembered[..known.min(MOST_OF_A_PAIR)],
            &contacts[start..end],
            &mut guess[start..end],
        );
        remembered = &remembered[known..];
        start = end;
    }
}

/// Writes down the contacts that push.
pub fn remember(id: &[u32], contacts: &[Contact], multipliers: &[f64], memory: &mut SolverMemory) {
    memory.contacts.clear();
    for (contact, &multiplier) in contacts.iter().zip(multipliers) {
        if multiplier > 0.0 {
            memory.contacts.push(Remembered {
                first: id[contact.i as usize],
                second: id[contact.j as usize],
                code: contact.code,
                multiplier,
            });
        }
    }
}

fn count_while(remembered: &[Remembered], matches: impl Fn(&Remembered) -> bool) -> usize {
    let mut count = 0;
    while count < remembered.len() && matches(&remembered[count]) {
        count += 1;
    }
    count
}

/// Hands what a pair's contacts had on to those it has.
fn inherit(known: &[Remembered], contacts: &[Contact], guess: &mut [f64]) {
    if known.is_empty() {
        return;
    }
    // Bit k: contact k of the last step has been handed on.
    let mut taken = 0u8;
    let mut hand_on = |guess: &mut f64, fits: &dyn Fn(u8) -> bool| {
        let place = (0..known.len()).find(|&k| taken & 1 << k == 0 && fits(known[k].code));
        if let Some(k) = place {
            taken |= 1 << k;
            *guess = known[k].multiplier;
        }
    };
    for (contact, guess) in contacts.iter().zip(&mut *guess) {
        hand_on(guess, &|code| code == contact.code);
    }
    for (contact, guess) in contacts.iter().zip(guess) {
        if *guess == 0.0 {
            hand_on(guess, &|code| ends(code) & ends(contact.code) != 0);
        }
    }
}

/// The ends a code names, as bits: head and tail of the first, head and tail of the second.
fn ends(code: u8) -> u8 {
    match code {
        0..4 => 1 << code,
        _ => 1 << ((code - 4) / 2) | 4 << ((code - 4) % 2),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multipliers_are_recalled_by_name_then_by_a_shared_end() {
        let contact = |i, j, code| Contact {
            i,
            j,
            code,
            gap: 0.0,
            normal: [1.0, 0.0],
            lever: [0.0; 2],
        };
        let old = |first, second, code, multiplier| Remembered {
            first,
            second,
            code,
            multiplier,
        };
        // The middle individual, id 20, is gone since.
        let contacts = vec![
            old(10, 20, 0, 1.0),
            old(10, 30, 1, 2.0),
            old(10, 30, 3, 3.0),
            old(20, 30, 0, 4.0),
            old(30, 40, 0, 5.0),
        ];
        let memory = SolverMemory { contacts };
        let now = [
            contact(0, 1, 1),
            contact(0, 1, 5),
            contact(0, 2, 0),
            contact(1, 2, 2),
            contact(1, 2, 4),
        ];
        let mut guess = Vec::new();
        recall(&memory, &[10, 30, 40], &now, &mut guess);
        // 5 is head with tail: it inherits from 3, the tail on a side; 4 is head with head: from
        // 0; 2, the other's head on a side, has no end in common with what was there.
        assert_eq!(guess, [2.0, 3.0, 0.0, 0.0, 5.0]);
    }
}
