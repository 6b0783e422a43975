//! Data folders after a crash: what is recovered from them, damaged or not.

mod damage;
mod disk;
mod recovery;
