//! Recordings on a slow disk.

mod steps;
