//! The fixtures of what a daemon sends are what daemons send: this scenario provokes each of them and
//! compares it with its file. With `JOSTLE_RECORD` set it writes the files instead.

mod controlled;
mod documents;
mod earlier;
mod experiments;
mod failing;
mod fleet;
mod lifecycle;
mod recording_client;
mod recordings;
mod swarms;

use documents::Recorded;

#[tokio::test(flavor = "multi_thread")]
async fn the_fixtures_of_what_a_daemon_sends_are_what_daemons_send() {
    let recorded = Recorded::default();
    tokio::join!(
        lifecycle::record_fixtures(&recorded),
        swarms::record_fixtures(&recorded),
        controlled::record_fixtures(&recorded),
        failing::record_fixtures(&recorded),
        experiments::record_fixtures(&recorded),
        recordings::record_fixtures(&recorded),
        fleet::record_fixtures(&recorded),
        earlier::record_fixtures(&recorded),
    );
    recorded.compare();
}
