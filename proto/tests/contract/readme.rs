//! What `README.md` says.
