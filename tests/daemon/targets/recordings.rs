//! A recording in MCAP, as a playback reads it.

use std::path::PathBuf;
use std::process;
use std::thread;

use jostled::playback::McapSource;

/// A file is rejected with a message, or each of its frames can be read, in their order.
pub fn check(data: &[u8]) {
    // One file for each thread that does this at the same time.
    let path: PathBuf = std::env::temp_dir().join(format!(
        "jostled-recording-{}-{:?}.mcap",
        process::id(),
        thread::current().id()
    ));
    std::fs::write(&path, data).expect("the temporary folder takes a file");
    let opened = McapSource::open(std::slice::from_ref(&path), &|_, _| {
        Err("commands are fuzzed as `orders`".to_owned())
    });
    match opened {
        Ok(mut source) => {
            let frames = source.index().len();
            assert!(frames > 0);
            let positions = source.index().iter().map(|index| index.position);
            assert!(positions.is_sorted());
            for frame in 0..frames {
                let read = source
                    .frame(frame)
                    .expect("it was looked at when it was opened");
                assert!(read.configuration.n() <= source.max_individuals);
            }
            assert!(source.events.iter().all(|event| event.after <= frames));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    std::fs::remove_file(&path).expect("it was just written");
}
