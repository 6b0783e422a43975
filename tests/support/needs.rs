//! The harness of the tests: tests that lack a tool fail unless they may be skipped, and `tests/within`
//! ends a command that takes too long.

use std::fs::File;
use std::io::Write as _;
use std::panic::Location;

/// Something that a machine may lack.
#[derive(Clone, Copy)]
pub struct Need {
    name: &'static str,
    remedy: &'static str,
}

pub const LIBFIU: Need = Need {
    name: "libfiu",
    remedy: "apt-get install fiu-utils",
};

pub const FAKETIME: Need = Need {
    name: "faketime",
    remedy: "apt-get install faketime",
};

pub const MOUNT: Need = Need {
    name: "mount",
    remedy: "run the tests as root, where a tmpfs may be mounted",
};

impl Need {
    /// Fails the calling test, which lacks this, unless `JOSTLE_MAY_SKIP` names it. The skipped test is
    /// then recorded in the file that `JOSTLE_SKIPPED` names, and the caller returns.
    #[track_caller]
    pub fn is_missing(self) {
        let Need { name, remedy } = self;
        let allowed = std::env::var("JOSTLE_MAY_SKIP").unwrap_or_default();
        assert!(
            allowed.split(',').any(|it| it.trim() == name),
            "this test needs {name}: {remedy}; or set JOSTLE_MAY_SKIP={name} to skip it"
        );
        let place = Location::caller();
        let thread = std::thread::current();
        // With one test thread the tests run on the main thread.
        let test = match thread.name() {
            None | Some("main") => format!("{}:{}", place.file(), place.line()),
            Some(test) => test.to_owned(),
        };
        let line = format!("{name}: {test}\n");
        // Past the test runner's capture of output.
        let skipped = format!("skipped, needs {line}");
        std::io::stderr().write_all(skipped.as_bytes()).unwrap();
        if let Some(path) = std::env::var_os("JOSTLE_SKIPPED") {
            let mut options = File::options();
            let mut file = options.create(true).append(true).open(path).unwrap();
            file.write_all(line.as_bytes()).unwrap();
        }
    }
}
