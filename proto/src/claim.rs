//! Claims: liveliness tokens by which daemons notice that two of them hold one name.

use std::collections::BTreeMap;

use serde_json::json;

use crate::{Error, ErrorCode, keys};

/// The standing of a daemon's claim to a name: the last chunk of the claim's key. Ordered by how
/// much would be lost if the daemon yielded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Standing {
    /// It does not serve the name.
    Waiting,
    /// It serves the name and has neither created the swarm nor executed a command on it since it
    /// began to.
    Serving,
    /// It serves the name and has created the swarm or executed commands on it since it began to.
    Changed,
}

impl Standing {
    /// Every standing, the lowest first.
    pub const ALL: [Standing; 3] = [Standing::Waiting, Standing::Serving, Standing::Changed];

    /// The chunk of the key.
    pub fn word(self) -> &'static str {
        match self {
            Standing::Waiting => "waiting",
            Standing::Serving => "serving",
            Standing::Changed => "changed",
        }
    }
}

/// A daemon that claims a name. Ordered by when it started.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Claimant {
    /// One run of a daemon: the time of its start, then the id of its zenoh session.
    pub instance: String,
    /// The daemon's name.
    pub node: String,
}

/// The content of a claim's key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Claim {
    /// The swarm whose name is claimed; `None` for the daemon's own name.
    pub swarm: Option<String>,
    /// The daemon that claims it.
    pub claimant: Claimant,
    /// The standing of the claim.
    pub standing: Standing,
}

impl Claim {
    /// The claim's key.
    pub fn key(&self, prefix: &str) -> String {
        let Claimant { instance, node } = &self.claimant;
        let standing = self.standing.word();
        match &self.swarm {
            Some(swarm) => keys::claim(prefix, swarm, node, instance, standing),
            None => keys::node_claim(prefix, node, instance, standing),
        }
    }

    /// Parses the key of a claim; `None` if it is not one.
    pub fn read(prefix: &str, key: &str) -> Option<Self> {
        let rest = key.strip_prefix(prefix)?.strip_prefix('/')?;
        let (swarm, node, instance, standing) = match rest.split('/').collect::<Vec<_>>()[..] {
            ["@node", node, "claim", instance, standing] => (None, node, instance, standing),
            [swarm, "claim", node, instance, standing] => (Some(swarm), node, instance, standing),
            _ => return None,
        };
        let standing = Standing::ALL.into_iter().find(|it| it.word() == standing)?;
        let names = [Some(node), Some(instance), swarm];
        names
            .into_iter()
            .flatten()
            .all(keys::is_name)
            .then(|| Claim {
                swarm: swarm.map(str::to_owned),
                claimant: Claimant {
                    instance: instance.to_owned(),
                    node: node.to_owned(),
                },
                standing,
            })
    }
}

/// The daemons that serve one name, if there are several: a command to it would be executed by
/// each of them. Ordered by when they started.
pub fn servers(claims: &[Claim]) -> Option<Vec<Claimant>> {
    let mut standings = BTreeMap::new();
    for claim in claims {
        let standing = standings.entry(&claim.claimant).or_insert(claim.standing);
        *standing = claim.standing.max(*standing);
    }
    let serving = standings
        .into_iter()
        .filter(|(_, it)| *it > Standing::Waiting);
    let serving: Vec<Claimant> = serving.map(|(claimant, _)| claimant.clone()).collect();
    (serving.len() > 1).then_some(serving)
}

/// The error for a request to a name that several daemons serve. A client raises it after reading
/// their claims, and each of the daemons replies with it.
pub fn rejection(swarm: Option<&str>, servers: &[Claimant]) -> Error {
    let names: Vec<String> = servers.iter().map(|it| format!("{:?}", it.node)).collect();
    let message = match swarm {
        Some(swarm) => format!(
            "the daemons {} each have a swarm {swarm:?}, so none executes anything on it: stop all \
             but one, or delete it on all but one with `jostle delete {swarm} --node NAME`",
            names.join(" and ")
        ),
        None => format!(
            "{} daemons are named {}, so none executes anything: stop all but one, and start the \
             others with another --node and --data-dir",
            servers.len(),
            names.first().map_or("alike", String::as_str)
        ),
    };
    error(swarm, servers, message)
}

/// The error for a request to a name that no reachable daemon serves: a reachable daemon holds it
/// and waits, mostly because another daemon, which is not reachable from here, serves it.
pub fn unserved(claims: &[Claim]) -> Option<Error> {
    let waiting = claims.iter().find(|it| it.standing == Standing::Waiting)?;
    let serving = claims.iter().find(|it| it.standing > Standing::Waiting);
    let (swarm, node) = (waiting.swarm.as_deref(), &waiting.claimant.node);
    let other = match serving {
        Some(other) => format!("because daemon {:?} does", other.claimant.node),
        None => "because it waits for the claims of other daemons".to_owned(),
    };
    let message = match swarm {
        Some(swarm) => format!(
            "daemon {node:?} does not serve its swarm {swarm:?}, {other}: connect to the other \
             daemon, or delete one of the two with `jostle delete {swarm} --node NAME`"
        ),
        None => format!(
            "a daemon named {node:?} does not serve, {other}: give one of them another --node and \
             --data-dir"
        ),
    };
    let both = std::iter::once(waiting).chain(serving);
    let both: Vec<Claimant> = both.map(|it| it.claimant.clone()).collect();
    Some(error(swarm, &both, message))
}

fn error(swarm: Option<&str>, claimants: &[Claimant], message: String) -> Error {
    let each = |field: fn(&Claimant) -> &String| claimants.iter().map(field).collect::<Vec<_>>();
    let details = [
        ("swarm", json!(swarm)),
        ("nodes", json!(each(|it| &it.node))),
        ("instances", json!(each(|it| &it.instance))),
    ];
    Error {
        code: ErrorCode::Contested,
        message,
        details: details
            .map(|(name, value)| (name.to_owned(), value))
            .into_iter()
            .collect(),
        step: None,
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn claim(swarm: Option<&str>, instance: &str, standing: Standing) -> Claim {
        Claim {
            swarm: swarm.map(str::to_owned),
            claimant: Claimant {
                instance: instance.to_owned(),
                node: "here".to_owned(),
            },
            standing,
        }
    }

    #[test]
    fn a_claim_is_read_from_its_key_and_from_no_other() {
        for swarm in [None, Some("ants")] {
            for standing in Standing::ALL {
                let claim = claim(swarm, "18f-ab", standing);
                assert_eq!(Claim::read("jostle", &claim.key("jostle")).unwrap(), claim);
            }
        }
        for key in [
            "jostle/ants/alive/here",
            "jostle/ants/claim/here/1/gone",
            "jostle/ants/claim/here/1",
            "jostle/*/claim/here/1/changed",
            "jostle/ants/claim/@here/1/changed",
            "other/ants/claim/here/1/changed",
        ] {
            assert_eq!(Claim::read("jostle", key), None, "{key}");
        }
    }

    #[test]
    fn two_that_serve_contest_a_name_and_one_that_waits_does_not() {
        let [waiting, serving, changed] = Standing::ALL;
        let it = |instance, standing| claim(Some("ants"), instance, standing);
        assert_eq!(servers(&[]), None);
        assert_eq!(servers(&[it("1", changed), it("2", waiting)]), None);
        // One daemon whose standing changes.
        assert_eq!(servers(&[it("1", serving), it("1", changed)]), None);
        let two = servers(&[it("2", serving), it("1", changed)]).unwrap();
        assert_eq!(two.len(), 2);
        assert_eq!(two[0].instance, "1");
    }
}
