//! The liveliness tokens of controllers: which are declared, and the requests that wait for one.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Instant;

use jostle_proto::keys;
use parking_lot::Mutex;
use tokio::runtime::Handle as Runtime;
use tokio::time::sleep_until;

use crate::api::context::{self, MAX_TOKEN_WAIT, OnToken};
use crate::suspension;

/// The tokens that are declared. Clones share them.
#[derive(Clone)]
pub struct Tokens {
    prefix: Arc<str>,
    /// Executes the timeouts.
    runtime: Runtime,
    known: Arc<Mutex<Known>>,
}

#[derive(Default)]
struct Known {
    /// The keys of the tokens that are declared. zenoh keeps each of them, too.
    held: HashSet<String>,
    /// What waits for a token: its key, and what is called.
    waiting: BTreeMap<u64, (String, OnToken)>,
    /// The number of the last one that waited.
    last: u64,
    /// The key of the token that is being looked for, unless it was declared or undeclared meanwhile.
    queried: Option<String>,
}

impl Tokens {
    /// No tokens yet; timeouts are tasks of the current runtime.
    pub fn new(prefix: &str) -> Self {
        Tokens {
            prefix: prefix.into(),
            runtime: Runtime::current(),
            known: Arc::default(),
        }
    }

    /// Notes that the token of this key is declared.
    pub fn declared(&self, key: &str) {
        let mut known = self.known.lock();
        known.queried.take_if(|it| it == key);
        known.hold(key);
    }

    /// Notes that the token of this key is gone.
    pub fn undeclared(&self, key: &str) {
        let mut known = self.known.lock();
        known.queried.take_if(|it| it == key);
        known.held.remove(key);
    }

    /// Looks for the token of this key, by `exists`, and notes whether it is declared: another session may
    /// have declared it, too. `None` if it was declared or undeclared meanwhile, so that the result may be
    /// outdated; one thread calls this.
    pub fn query(&self, key: &str, exists: impl FnOnce() -> bool) -> Option<bool> {
        self.known.lock().queried = Some(key.to_owned());
        let exists = exists();
        let mut known = self.known.lock();
        known.queried.take()?;
        match exists {
            true => known.hold(key),
            false => _ = known.held.remove(key),
        }
        Some(exists)
    }

    /// Calls `then` unless the token of this key is declared; it is not declared before `then` returns.
    pub fn unless_held<T>(&self, key: &str, then: impl FnOnce() -> T) -> Option<T> {
        let known = self.known.lock();
        (!known.held.contains(key)).then(then)
    }

    /// The controllers of a swarm whose tokens are declared.
    pub fn controllers(&self, swarm: &str) -> BTreeSet<String> {
        let known = self.known.lock();
        let keys = known.held.iter();
        let parts =
            keys.filter_map(|key| parts(key.strip_prefix(&*self.prefix)?.strip_prefix('/')?));
        let own = parts.filter(|(of, _)| *of == swarm);
        own.map(|(_, controller)| controller.to_owned()).collect()
    }

    fn expire(&self, number: u64) {
        let waiting = self.known.lock().waiting.remove(&number);
        if let Some((_, then)) = waiting {
            then(false);
        }
    }
}

impl Known {
    fn hold(&mut self, key: &str) {
        self.held.insert(key.to_owned());
        let waits = |(_, (waits_for, _)): &(&u64, &(String, OnToken))| waits_for == key;
        let waiting = self.waiting.iter().filter(waits);
        let waiting: Vec<u64> = waiting.map(|(number, _)| *number).collect();
        for number in waiting {
            if let Some((_, then)) = self.waiting.remove(&number) {
                then(true);
            }
        }
    }
}

/// The swarm and the controller in a key without its prefix; `None` if it contains a wildcard.
pub fn parts(key: &str) -> Option<(&str, &str)> {
    let (swarm, rest) = key.split_once("/ctl/")?;
    let controller = rest.split('/').next()?;
    (keys::is_name(swarm) && keys::is_name(controller)).then_some((swarm, controller))
}

impl context::Tokens for Tokens {
    fn is_held(&self, swarm: &str, controller: &str) -> bool {
        let key = keys::ctl_alive(&self.prefix, swarm, controller);
        self.known.lock().held.contains(&key)
    }

    fn await_token(&self, swarm: &str, controller: &str, then: OnToken) {
        let key = keys::ctl_alive(&self.prefix, swarm, controller);
        let mut known = self.known.lock();
        if known.held.contains(&key) {
            // Locked, so that the loss of the token reaches the swarm after what this sends.
            return then(true);
        }
        known.last += 1;
        let number = known.last;
        known.waiting.insert(number, (key, then));
        drop(known);
        let (tokens, watch, began) = (self.clone(), suspension::watch(), Instant::now());
        self.runtime.spawn(async move {
            let _watch = watch;
            let mut from = began;
            loop {
                sleep_until((from + MAX_TOKEN_WAIT).into()).await;
                // While the daemon was suspended it could not receive the token.
                match suspension::resumed().filter(|resumed| *resumed > from) {
                    Some(resumed) => from = resumed,
                    None => return tokens.expire(number),
                }
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::context::Tokens as _;
    use super::*;

    #[tokio::test]
    async fn what_a_query_found_is_outdated_once_the_token_is_declared_or_undeclared() {
        let tokens = Tokens::new("p");
        let key = |controller| keys::ctl_alive("p", "a", controller);
        let (ada, bob) = (&*key("ada"), &*key("bob"));
        tokens.declared(ada);
        let found = tokens.query(ada, || {
            tokens.undeclared(ada);
            true
        });
        assert_eq!((found, tokens.is_held("a", "ada")), (None, false));
        let found = tokens.query(ada, || {
            tokens.declared(ada);
            false
        });
        assert_eq!((found, tokens.is_held("a", "ada")), (None, true));
        assert_eq!(tokens.unless_held(ada, || ()), None);
        // Another token makes no difference.
        let found = tokens.query(ada, || {
            tokens.declared(bob);
            false
        });
        assert_eq!((found, tokens.is_held("a", "ada")), (Some(false), false));
        assert_eq!(tokens.unless_held(ada, || ()), Some(()));
        tokens.undeclared(bob);
        let found = tokens.query(bob, || true);
        assert_eq!((found, tokens.is_held("a", "bob")), (Some(true), true));
    }

    #[tokio::test]
    async fn the_tokens_of_a_swarm_are_those_of_its_controllers() {
        let tokens = Tokens::new("p");
        for (swarm, controller) in [("a", "ada"), ("a", "bob"), ("b", "eve")] {
            tokens.declared(&keys::ctl_alive("p", swarm, controller));
        }
        tokens.declared("p/*/ctl/*/alive");
        let names = |swarm| Vec::from_iter(tokens.controllers(swarm));
        assert_eq!(names("a"), ["ada", "bob"]);
        assert_eq!(names("b"), ["eve"]);
        assert!(names("c").is_empty());
    }
}
