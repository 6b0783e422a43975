//! What one step remembers for the next: who pushed, and how hard.

use std::ops::Range;

use super::contact::Contact;
use crate::model::{WarmContact, WarmStart};

/// How many contacts a pair can have: one for each code.
const MOST_OF_A_PAIR: usize = 8;

/// Guesses the multipliers of `contacts` from the last step's.
///
/// A contact not seen before, of a pair that was in contact, inherits from one of the pair's
/// contacts that shares an end and is gone: the contact has passed from a side to a cap.
pub fn load(warm_start: &WarmStart, id: &[u32], contacts: &[Contact], guess: &mut Vec<f64>) {
    guess.clear();
    guess.resize(contacts.len(), 0.0);
    let old = &warm_start.contacts[..];
    let pair_of = |contact: &Contact| named(id[contact.i as usize], id[contact.j as usize]);
    let pair_then = |old: &WarmContact| named(old.first, old.second);
    // Both lists are ordered by pair and code, ids being ordered as indices are.
    let (mut k, mut index) = (0, 0);
    while k < old.len() {
        let pair = pair_then(&old[k]);
        let pair_now = contacts.get(index).map_or(u64::MAX, pair_of);
        if pair == pair_now && old[k].code == contacts[index].code {
            guess[index] = old[k].multiplier;
            (k, index) = (k + 1, index + 1);
        } else if pair > pair_now {
            index += 1;
        } else if pair == pair_now || index > 0 && pair_of(&contacts[index - 1]) == pair {
            // Here the pair has other contacts than it had: it is looked at as a whole.
            let known = around(old, k, |old| pair_then(old) == pair);
            let now = around(contacts, index, |contact| pair_of(contact) == pair);
            (k, index) = (known.end, now.end);
            let most = known.start + MOST_OF_A_PAIR;
            let known = &old[known.start..known.end.min(most)];
            inherit(known, &contacts[now.clone()], &mut guess[now]);
        } else {
            k += 1;
        }
    }
}

/// Writes down the contacts that push, and the order of elimination with its age.
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

/// The entries before and from `index` on that match, without a gap.
fn around<T>(entries: &[T], index: usize, matches: impl Fn(&T) -> bool) -> Range<usize> {
    let before = entries[..index]
        .iter()
        .rev()
        .take_while(|&entry| matches(entry));
    let after = entries[index..].iter().take_while(|&entry| matches(entry));
    index - before.count()..index + after.count()
}

/// A pair as one number, in the order of pairs.
fn named(first: u32, second: u32) -> u64 {
    u64::from(first) << 32 | u64::from(second)
}

/// Hands what a pair's contacts had on to those it has.
fn inherit(known: &[WarmContact], contacts: &[Contact], guess: &mut [f64]) {
    // Bit k: contact k of the last step has been handed on.
    let (mut taken, mut k) = (0u32, 0);
    for (contact, guess) in contacts.iter().zip(&mut *guess) {
        while k < known.len() && known[k].code < contact.code {
            k += 1;
        }
        if k < known.len() && known[k].code == contact.code {
            *guess = known[k].multiplier;
            taken |= 1 << k;
        }
    }
    if taken + 1 == 1 << known.len() {
        return;
    }
    for (contact, guess) in contacts.iter().zip(guess) {
        let shares_end = |old: &WarmContact| ends(old.code) & ends(contact.code) != 0;
        let fits = |&k: &usize| taken & 1 << k == 0 && shares_end(&known[k]);
        if *guess == 0.0
            && let Some(k) = (0..known.len()).find(fits)
        {
            *guess = known[k].multiplier;
            taken |= 1 << k;
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
        let old = |first, second, code, multiplier| WarmContact {
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
        // 5 is head with tail: it inherits from 3, the tail on a side; 4 is head with head: from
        // 0; 2, the other's head on a side, has no end in common with what was there.
        assert_eq!(guess, [2.0, 3.0, 0.0, 0.0, 5.0]);
    }
}
