//! The liveliness tokens of clients that wait for conditions: the thread `waits` queries which of them exist.

use std::collections::{BTreeSet, HashMap};
use std::ops::Bound;
use std::sync::{Arc, Weak};
use std::thread;
use std::time::Duration;

use jostle_proto::keys;
use parking_lot::{Condvar, Mutex};
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

use crate::swarm::awaited::Holder;

/// The timeout of a query for a token.
const TOKEN_QUERY_TIMEOUT: Duration = Duration::from_secs(1);

/// At this number of holders and at twice the number that is left then, those that no wait needs are removed.
const MIN_PRUNED: usize = 256;

/// The tokens that waits need. Clones share them.
#[derive(Clone)]
pub struct WaitTokens(Arc<Inner>);

struct Inner {
    prefix: String,
    tokens: Mutex<Tokens>,
    changed: Condvar,
}

#[derive(Default)]
struct Tokens {
    /// By key: those that a wait still needs, and some others.
    holders: HashMap<String, Weak<Holder>>,
    /// The keys of tokens that were declared, undeclared or not looked for yet.
    unknown: BTreeSet<String>,
    /// The key that was looked for last.
    last: String,
    prune_at: usize,
    is_closed: bool,
}

/// Ends the thread when it is dropped.
pub struct WaitTokensSubscriber {
    tokens: WaitTokens,
    _subscriber: Subscriber<()>,
}

impl WaitTokens {
    /// No tokens yet, of the swarms below `prefix`.
    pub fn new(prefix: &str) -> Self {
        WaitTokens(Arc::new(Inner {
            prefix: prefix.to_owned(),
            tokens: Mutex::default(),
            changed: Condvar::new(),
        }))
    }

    /// The token of a wait, which is looked for from now on until the holder is dropped.
    pub fn holder(&self, swarm: &str, id: &str) -> Arc<Holder> {
        let key = keys::wait_alive(&self.0.prefix, swarm, id);
        let mut tokens = self.0.tokens.lock();
        if let Some(holder) = tokens.holders.get(&key).and_then(Weak::upgrade) {
            return holder;
        }
        if tokens.holders.len() >= tokens.prune_at.max(MIN_PRUNED) {
            tokens.holders.retain(|_, it| it.strong_count() > 0);
            tokens.prune_at = 2 * tokens.holders.len();
        }
        let holder = Arc::new(Holder::token(key.clone()));
        tokens.holders.insert(key.clone(), Arc::downgrade(&holder));
        tokens.unknown.insert(key);
        self.0.changed.notify_one();
        holder
    }

    /// Starts the thread, and subscribes to the tokens.
    pub fn listen(&self, session: &Session) -> zenoh::Result<WaitTokensSubscriber> {
        let (tokens, asking) = (self.clone(), session.clone());
        thread::Builder::new()
            .name("waits".into())
            .spawn(move || tokens.run(&asking))?;
        let tokens = self.clone();
        let subscriber = session
            .liveliness()
            .declare_subscriber(keys::wait_alive(&self.0.prefix, "*", "*"))
            .callback(move |sample| {
                let is_undeclared = sample.kind() == SampleKind::Delete;
                tokens.changed(sample.key_expr().as_str(), is_undeclared);
            })
            .wait()?;
        Ok(WaitTokensSubscriber {
            tokens: self.clone(),
            _subscriber: subscriber,
        })
    }

    /// A token was declared or undeclared: of those that no wait needs nothing is kept.
    fn changed(&self, key: &str, is_undeclared: bool) {
        let mut tokens = self.0.tokens.lock();
        if let Some(holder) = tokens.holders.get(key) {
            if is_undeclared && let Some(holder) = holder.upgrade() {
                holder.note_undeclared();
            }
            tokens.unknown.insert(key.to_owned());
            self.0.changed.notify_one();
        }
    }

    fn run(&self, session: &Session) {
        loop {
            let mut tokens = self.0.tokens.lock();
            while tokens.unknown.is_empty() && !tokens.is_closed {
                self.0.changed.wait(&mut tokens);
            }
            if tokens.is_closed {
                return;
            }
            let key = tokens.next();
            let holder = key.as_ref().and_then(|key| tokens.holders.get(key));
            let holder = holder.and_then(Weak::upgrade);
            drop(tokens);
            if let (Some(key), Some(holder)) = (key, holder) {
                // Another session may declare the same token: a client that has reconnected before zenoh
                // noticed that its first connection was closed.
                let found = session.liveliness().get(key).timeout(TOKEN_QUERY_TIMEOUT);
                let found = found.wait();
                let exists = found
                    .is_ok_and(|tokens| tokens.into_iter().any(|token| token.result().is_ok()));
                holder.set(exists);
            }
        }
    }
}

impl Tokens {
    /// Takes the key after the last one, or else the first: a client that declares one token again and again
    /// does not delay those of others.
    fn next(&mut self) -> Option<String> {
        let after = (Bound::Excluded(self.last.as_str()), Bound::Unbounded);
        let next = self.unknown.range::<str, _>(after).next();
        let next = next.or_else(|| self.unknown.first()).cloned()?;
        self.unknown.remove(&next);
        self.last.clone_from(&next);
        Some(next)
    }
}

impl Drop for WaitTokensSubscriber {
    fn drop(&mut self) {
        self.tokens.0.tokens.lock().is_closed = true;
        self.tokens.0.changed.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_that_changes_again_and_again_does_not_delay_others() {
        let mut tokens = Tokens {
            unknown: ["a", "b", "c"].map(str::to_owned).into(),
            ..Tokens::default()
        };
        let next = [(); 5].map(|()| {
            let next = tokens.next();
            tokens.unknown.insert("a".to_owned());
            next
        });
        let next = next.map(Option::unwrap);
        assert_eq!(next, ["a", "b", "c", "a", "a"]);
        tokens.unknown.clear();
        assert_eq!(tokens.next(), None);
    }
}
