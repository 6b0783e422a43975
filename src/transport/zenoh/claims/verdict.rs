//! Who may serve a name that several daemons claim. Pure: the same claims give the same verdict on
//! every daemon.

use std::collections::{BTreeMap, BTreeSet};

use jostle_proto::{Claimant, Standing};

/// The claims of other daemons on one name. A daemon whose standing changes holds two claims for a
/// moment, of which the higher counts.
pub type Others = BTreeMap<Claimant, BTreeSet<Standing>>;

/// Whether a daemon may serve a name that it claims.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It may.
    Serve,
    /// Another daemon serves it.
    Wait(Claimant),
    /// Several daemons have executed commands on swarms of this name: none may.
    Reject(Claimant),
}

/// Whether the daemon `own` may serve the name, beside `others`.
///
/// Of two daemons at least one yields or both reject, as long as each knows the other's claim: the
/// daemon with the lower standing yields, and of equal ones the daemon that started later. If both
/// executed commands, neither yields, since that would revoke acknowledged commands.
pub fn judge(standing: Standing, own: &Claimant, others: &Others) -> Verdict {
    let rival = others
        .iter()
        .filter_map(|(claimant, standings)| Some((*standings.last()?, claimant)))
        .max_by(|(a, first), (b, second)| a.cmp(b).then(second.cmp(first)));
    match rival {
        Some((Standing::Changed, rival)) if standing == Standing::Changed => {
            Verdict::Reject(rival.clone())
        }
        Some((higher, rival)) if higher > standing => Verdict::Wait(rival.clone()),
        Some((equal, rival)) if equal == standing && rival < own => Verdict::Wait(rival.clone()),
        _ => Verdict::Serve,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claimant(instance: &str) -> Claimant {
        Claimant {
            instance: instance.to_owned(),
            node: format!("node-{instance}"),
        }
    }

    #[test]
    fn of_any_claimants_at_most_one_serves_and_only_changed_ones_reject() {
        let names = ["1", "2", "3"].map(claimant);
        let present = |count: usize| {
            (0..4_usize.pow(3)).filter_map(move |code| {
                let standings: Vec<Option<Standing>> = (0..3)
                    .map(|i| {
                        let digit = code / 4_usize.pow(i) % 4;
                        digit.checked_sub(1).map(|it| Standing::ALL[it])
                    })
                    .collect();
                (standings.iter().flatten().count() == count).then_some(standings)
            })
        };
        for standings in (1..=3).flat_map(present) {
            let verdicts: Vec<(Standing, Verdict)> = (0..3)
                .filter_map(|i| {
                    let others: Others = (0..3)
                        .filter(|&j| j != i)
                        .filter_map(|j| Some((names[j].clone(), [standings[j]?].into())))
                        .collect();
                    Some((standings[i]?, judge(standings[i]?, &names[i], &others)))
                })
                .collect();
            let count = |is: fn(&(Standing, Verdict)) -> bool| {
                let verdicts = verdicts.iter();
                verdicts.filter(|it| is(it)).count()
            };
            let serving = count(|(_, it)| *it == Verdict::Serve);
            let rejecting = count(|(_, it)| matches!(it, Verdict::Reject(_)));
            let changed = count(|(it, _)| *it == Standing::Changed);
            let expected = if changed > 1 { (0, changed) } else { (1, 0) };
            assert_eq!((serving, rejecting), expected, "{verdicts:?}");
        }
    }

    #[test]
    fn of_two_claims_of_one_daemon_the_higher_counts() {
        let own = claimant("1");
        let both = BTreeSet::from([Standing::Waiting, Standing::Changed]);
        let others = Others::from([(claimant("2"), both)]);
        let serving = judge(Standing::Serving, &own, &others);
        assert!(matches!(serving, Verdict::Wait(_)));
        let changed = judge(Standing::Changed, &own, &others);
        assert!(matches!(changed, Verdict::Reject(_)));
    }
}
