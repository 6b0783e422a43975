//! Whether a swarm is still there, as it is watched: its and its node's liveliness tokens.

mod whereabouts;

use jostle_proto::keys;
use tokio::time::{Instant, sleep_until};
use zenoh::sample::{Sample, SampleKind};

use self::whereabouts::Whereabouts;
pub use self::whereabouts::{News, RISE};
use crate::bus::{Bus, Samples, node_of};
use crate::failure::Failure;

/// How many tokens may wait to be looked at.
const BACKLOG: usize = 64;

/// What people are told when the daemon is gone.
pub const GONE: &str = "the daemon is gone; waiting for it to come back, Ctrl-C ends";
/// What they are told when it is there again.
pub const BACK: &str = "the daemon is back";

/// Looks out for a swarm.
pub struct Lookout<'a> {
    bus: &'a Bus,
    swarm: &'a str,
    swarm_tokens: Samples,
    node_tokens: Samples,
    whereabouts: Whereabouts,
    node: Option<String>,
}

impl<'a> Lookout<'a> {
    /// Subscribes to the tokens.
    ///
    /// # Errors
    ///
    /// [`Failure::Unreadable`] when zenoh does not take the key.
    pub async fn begin(bus: &'a Bus, swarm: &'a str) -> Result<Self, Failure> {
        let prefix = bus.prefix();
        Ok(Lookout {
            swarm_tokens: bus
                .subscribe_tokens(&keys::alive(prefix, swarm, "*"), BACKLOG)
                .await?,
            node_tokens: bus
                .subscribe_tokens(&keys::node_alive(prefix, "*"), BACKLOG)
                .await?,
            bus,
            swarm,
            whereabouts: Whereabouts::Here,
            node: None,
        })
    }

    /// Waits for news; nothing is lost if it is not waited for to the end.
    ///
    /// # Errors
    ///
    /// [`Failure::Deleted`] and [`Failure::LeftBehind`] when the swarm will not come back.
    pub async fn news(&mut self) -> Result<News, Failure> {
        loop {
            let news = tokio::select! {
                biased;
                token = self.swarm_tokens.recv_async() => {
                    self.swarm_token(&token.map_err(Failure::defect)?)
                }
                token = self.node_tokens.recv_async() => {
                    self.node_token(&token.map_err(Failure::defect)?);
                    None
                }
                () = reach(self.whereabouts.deadline()) => self.judge().await?,
            };
            let swarm = || self.swarm.to_owned();
            match news {
                Some(News::Deleted) => return Err(Failure::Deleted { swarm: swarm() }),
                Some(News::LeftBehind) => return Err(Failure::LeftBehind { swarm: swarm() }),
                Some(news) => return Ok(news),
                None => {}
            }
        }
    }

    fn swarm_token(&mut self, token: &Sample) -> Option<News> {
        let is_alive = token.kind() == SampleKind::Put;
        if is_alive {
            self.node = node_of(self.bus.prefix(), token.key_expr().as_str());
        }
        self.whereabouts.swarm_token(is_alive, Instant::now())
    }

    fn node_token(&mut self, token: &Sample) {
        if self.is_its_node(node_of(self.bus.prefix(), token.key_expr().as_str()).as_ref()) {
            let is_alive = token.kind() == SampleKind::Put;
            self.whereabouts.node_token(is_alive, Instant::now());
        }
    }

    /// Says what became of a swarm whose token is gone.
    async fn judge(&mut self) -> Result<Option<News>, Failure> {
        let nodes = self.bus.nodes().await?;
        let is_node_there = nodes.iter().any(|node| self.is_its_node(Some(node)));
        Ok(self.whereabouts.judge(is_node_there))
    }

    /// Whether a node is the one that hosts the swarm, as far as is known.
    fn is_its_node(&self, node: Option<&String>) -> bool {
        self.node.is_none() || self.node.as_ref() == node
    }
}

/// Completes at `deadline`; never if there is none.
pub async fn reach(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}
