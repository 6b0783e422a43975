//! The warm start: the pushing contacts of one step and their multipliers, as a guess for the next.

use std::ops::Range;

use super::contact::Contact;
use crate::model::{WarmContact, WarmStart};

/// Contacts of a pair at most: one for each code.
const MAX_PER_PAIR: usize = 8;

/// Guesses the multipliers of `contacts` from those of the last step.
///
/// A new contact of a pair that was in contact inherits the multiplier of an old contact of that
/// pair that no longer exists and shares an end with it, as when a contact passes from a side to
/// an end.
///
/// - Shapes: n ids, ascending; m contacts ordered by (i, j, code); m entries in `guess`.
pub fn load(warm_start: &WarmStart, id: &[u32], contacts: &[Contact], guess: &mut Vec<f64>) {
    guess.clear();
    guess.resize(contacts.len(), 0.0);
    let old = &warm_start.contacts[..];
    let pair_of = |contact: &Contact| pair_key(id[contact.i as usize], id[contact.j as usize]);
    let pair_then = |old: &WarmContact| pair_key(old.first, old.second);
    // Both lists are ordered by pair and code, since ids and indices have the same order.
    let (mut k, mut index) = (0, 0);
    while k < old.len() {
        let pair = pair_then(&old[k]);
        let pair_now = contacts.get(index).map_or(u64::MAX, pair_of);
        if pair == pair_now && old[k].code == contacts[index].code {
            guess[index] = old[k].multiplier;
            (k, index) = (k + 1, index + 1);
        } else if pair > pair_now {
            index += 1;
        } else if pair == pair_now {
            // The contacts of this pair have changed: match all of them together.
            let previous = around(old, k, |old| pair_then(old) == pair);
            let now = around(contacts, index, |contact| pair_of(contact) == pair);
            (k, index) = (previous.end, now.end);
            let most = previous.start + MAX_PER_PAIR;
            let previous = &old[previous.start..previous.end.min(most)];
            transfer_multipliers(previous, &contacts[now.clone()], &mut guess[now]);
        } else {
            k += 1;
        }
    }
}

/// Stores the pushing contacts, and the elimination order with its age.
///
/// - Shapes: n ids; m contacts and m multipliers.
pub fn store(
    id: &[u32],
    contacts: &[Contact],
    multipliers: &[f64],
    (order, age): (&[u32], u32),
    warm_start: &mut WarmStart,
) {
    if warm_start.order != order {
        warm_start.order.clear();
        warm_start.order.extend_from_slice(order);
    }
    warm_start.order_age = age;
    warm_start.contacts.clear();
    for (contact, &multiplier) in contacts.iter().zip(multipliers) {
        if multiplier > 0.0 {
            warm_start.contacts.push(WarmContact {
                first: id[contact.i as usize],
                second: id[contact.j as usize],
                code: contact.code,
                multiplier,
            });
        }
    }
}

/// Returns the range of consecutive entries around `index` that match.
fn around<T>(entries: &[T], index: usize, matches: impl Fn(&T) -> bool) -> Range<usize> {
    let before = entries[..index]
        .iter()
        .rev()
        .take_while(|&entry| matches(entry));
    let after = entries[index..].iter().take_while(|&entry| matches(entry));
    index - before.count()..index + after.count()
}

/// Returns a number for each pair; numbers have the order of pairs.
fn pair_key(first: u32, second: u32) -> u64 {
    u64::from(first) << 32 | u64::from(second)
}

/// Transfers the multipliers of a pair's previous contacts to its present contacts.
fn transfer_multipliers(previous: &[WarmContact], contacts: &[Contact], guess: &mut [f64]) {
    // Bit k: the multiplier of previous contact k has been transferred.
    let (mut taken, mut k) = (0u32, 0);
    for (contact, guess) in contacts.iter().zip(&mut *guess) {
        while k < previous.len() && previous[k].code < contact.code {
            k += 1;
        }
        if k < previous.len() && previous[k].code == contact.code {
            *guess = previous[k].multiplier;
            taken |= 1 << k;
        }
    }
    if taken + 1 == 1 << previous.len() {
        return;
    }
    for (contact, guess) in contacts.iter().zip(guess) {
        let shares_end = |old: &WarmContact| ends(old.code) & ends(contact.code) != 0;
        let fits = |&k: &usize| taken & 1 << k == 0 && shares_end(&previous[k]);
        if *guess == 0.0
            && let Some(k) = (0..previous.len()).find(fits)
        {
            *guess = previous[k].multiplier;
            taken |= 1 << k;
        }
    }
}

/// Returns the ends in a code as bits: head and tail of the first body, then of the second.
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
    fn every_code_names_its_ends() {
        // Heads and tails of the first body, 1 and 2, and of the second, 4 and 8.
        let expected = [1, 2, 4, 8, 1 | 4, 1 | 8, 2 | 4, 2 | 8];
        for (code, expected) in (0..).zip(expected) {
            assert_eq!(ends(code), expected, "{code}");
        }
    }

    #[test]
    fn multipliers_are_loaded_by_code_then_by_a_shared_end() {
        let contact = |i, j, code| Contact {
            i,
            j,
            code,
            gap: 0.0,
            normal: [1.0, 0.0],
            lever: [0.0; 2],
        };
        let old = |first, second, code, multiplier| WarmContact {
            first,
            second,
            code,
            multiplier,
        };
        // The middle individual, id 20, has been removed.
        let contacts = vec![
            old(10, 20, 0, 1.0),
            old(10, 30, 1, 2.0),
            old(10, 30, 3, 3.0),
            old(20, 30, 0, 4.0),
            old(30, 40, 0, 5.0),
        ];
        let warm_start = WarmStart {
            contacts,
            ..WarmStart::default()
        };
        let now = [
            contact(0, 1, 1),
            contact(0, 1, 5),
            contact(0, 2, 0),
            contact(1, 2, 2),
            contact(1, 2, 4),
        ];
        let mut guess = Vec::new();
        load(&warm_start, &[10, 30, 40], &now, &mut guess);
        // Code 5 (head with tail) inherits from code 3 (tail on a side), and code 4 (head with
        // head) from code 0 (head on a side). Code 2 (the other's head on a side) shares no end
        // with code 0, and ids 10 and 40 were not in contact.
        assert_eq!(guess, [2.0, 3.0, 0.0, 0.0, 5.0]);
    }
}
