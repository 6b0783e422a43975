//! The fixtures of what a daemon sends are what daemons send: this scenario provokes each of them and
//! compares it with its file. With `JOSTLE_RECORD` set it writes the files instead.

mod controlled;
mod documents;
mod experiments;
mod failing;
mod fleet;
mod lab;
mod recordings;
mod story;
mod swarms;

use documents::Recorded;

use crate::support::beside_others;

#[tokio::test(flavor = "multi_thread")]
async fn the_fixtures_of_what_a_daemon_sends_are_what_daemons_send() {
    let _machine = beside_others().await;
    let recorded = Recorded::default();
    tokio::join!(
        story::play(&recorded),
        swarms::play(&recorded),
        controlled::play(&recorded),
        failing::play(&recorded),
        experiments::play(&recorded),
        recordings::play(&recorded),
        fleet::play(&recorded),
    );
    recorded.compare();
}
