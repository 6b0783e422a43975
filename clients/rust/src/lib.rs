//! The Rust client of jostle: commands and queries to the swarms that `jostled` hosts, and their
//! updates. Messages are the types of [`jostle_proto`], re-exported as [`proto`].
//!
//! # Quick start
//!
//! ```
//! use jostle_client::{Client, ConnectOptions};
//! use jostle_client::proto::{Spec, verbs::*};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/examples_daemon.rs"));
//! # #[tokio::main(flavor = "multi_thread")]
//! # async fn main() -> Result<(), jostle_client::Error> {
//! # let daemon = Daemon::start().await;
//! # let endpoint = daemon.endpoint();
//!
//! let client = Client::connect(ConnectOptions::to(endpoint)).await?;
//! let (name, spec) = ("school".to_owned(), Spec::new(50));
//! client.create(&CreateArgs { name, spec, exist_ok: false }).await?;
//!
//! // Returns after the last step, with the state.
//! let step = StepArgs { steps: 100, return_: Return::State };
//! let reply = client.execute("school", &step).await?;
//! assert_eq!(reply.step, 100);
//! assert_eq!(reply.result.state.map(|state| state.x.len()), Some(50));
//!
//! // A tenth of them gets the direction +x.
//! let select = Select::Fraction(0.1);
//! let inform = InformArgs { select, direction: 0.0, weight: None, for_time: None };
//! let reply = client.execute("school", &inform).await?;
//! assert_eq!(reply.result.ids.len(), 5);
//! client.close().await;
//! # Ok(())
//! # }
//! ```
//!
//! A request is retried until [`ConnectOptions::timeout`] if its reply may be lost, or the daemon is
//! busy or not reachable. A command is executed once however often it is sent, because it has a request
//! id. What is left when a future is dropped is in its line *Cancel safety*.
//!
//! # Follow a swarm
//!
//! [`Client::follow`] streams the updates that [`FollowOptions`] select. It continues through lost
//! connections and restarts of the daemon, which it reports as updates, and ends with
//! [`Update::Deleted`]:
//!
//! ```
//! use jostle_client::{Client, ConnectOptions, EventsFrom, FollowOptions, Update};
//! use jostle_client::proto::{Spec, verbs::*};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/examples_daemon.rs"));
//! # #[tokio::main(flavor = "multi_thread")]
//! # async fn main() -> Result<(), jostle_client::Error> {
//! # let daemon = Daemon::start().await;
//! # let endpoint = daemon.endpoint();
//! # let client = Client::connect(ConnectOptions::to(endpoint)).await?;
//! # let (name, spec) = ("school".to_owned(), Spec::new(50));
//! # client.create(&CreateArgs { name, spec, exist_ok: false }).await?;
//! let options = FollowOptions {
//!     // The queue holds the newest state: a slow reader skips states and does not lag.
//!     states: Some(1),
//!     events: Some(EventsFrom::Now),
//!     ..FollowOptions::default()
//! };
//! let mut updates = client.follow("school", options).await?;
//! client.execute("school", &RunArgs::default()).await?;
//! while let Some(update) = updates.next().await {
//!     match update? {
//!         Update::State(state) => println!("step {}: order {}", state.step, state.order.order),
//!         Update::Event(event) => println!("event {}: {:?}", event.number, event.event),
//!         Update::Away => println!("the daemon is unreachable"),
//!         Update::Restarted { epoch } => println!("recovered in epoch {epoch}"),
//!         Update::Deleted => println!("deleted"),
//!         _ => {}
//!     }
//! #   let _ = client.execute("school", &DeleteArgs {}).await;
//! }
//! # client.close().await;
//! # Ok(())
//! # }
//! ```
//!
//! # A controller in lock-step
//!
//! [`Client::join`] registers a [`Controller`]. The swarm steps when every controller has advanced:
//!
//! ```
//! use jostle_client::{Client, ConnectOptions};
//! use jostle_client::proto::{Spec, verbs::*};
//! # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/examples_daemon.rs"));
//! # #[tokio::main(flavor = "multi_thread")]
//! # async fn main() -> Result<(), jostle_client::Error> {
//! # let daemon = Daemon::start().await;
//! # let endpoint = daemon.endpoint();
//! # let client = Client::connect(ConnectOptions::to(endpoint)).await?;
//! # let (name, spec) = ("school".to_owned(), Spec::new(50));
//! # client.create(&CreateArgs { name, spec, exist_ok: false }).await?;
//! let join = JoinArgs {
//!     controller: "pilot".into(),
//!     select: Some(Select::Ids(vec![0, 1])),
//!     mode: Mode::Lockstep,
//!     deadline_secs: 5.0,
//!     on_timeout: OnTimeout::Free,
//!     driving: false,
//!     again: false,
//! };
//! let (mut controller, joined) = client.join("school", join).await?;
//! let ids = joined.result.ids;
//! for k in 0..10 {
//!     let direction = vec![0.1 * f64::from(k); ids.len()];
//!     let set = SetPoints { ids: ids.clone(), direction, ..SetPoints::default() };
//!     let reply = controller.advance(5, Some(set), Return::State).await?;
//!     let Some(state) = reply.result.state else { continue };
//!     println!("step {}: drift {:?}", state.step, state.order.drift);
//! }
//! assert_eq!(controller.step(), 50);
//! controller.leave().await?;
//! # client.close().await;
//! # Ok(())
//! # }
//! ```
//!
//! [`Client::session`] returns the zenoh session, for operations that the crate does not offer.

mod client;
mod connect;
mod controller;
mod data_ids;
mod discovery;
mod error;
mod follow;
mod payload;
mod presence;
mod published;
mod requests;
mod retry;
mod tls;
mod wait;
mod wait_numbers;

pub use jostle_proto as proto;

pub use client::{Client, Subscription, Target};
pub use connect::{ConnectOptions, DEFAULT_ENDPOINT};
pub use controller::Controller;
pub use error::Error;
pub use follow::{EventsFrom, Follow, FollowOptions, Update};
pub use jostle_proto::verbs::Command;
pub use payload::{Message, Payload};
pub use requests::{CommandOptions, MAY_EXECUTE};
pub use wait::ConditionWait;

/// The example of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
