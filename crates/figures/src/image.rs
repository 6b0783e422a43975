//! Image files: SVG unchanged, PNG rendered with the font that this crate embeds.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

/// Pixels of a PNG per pixel of the picture: sharp on high-density screens and in print.
const DENSITY: f32 = 2.0;

/// An error of saving a picture.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The file name has none of the known extensions.
    #[error("save {}: its name ends in neither .svg nor .png", path.display())]
    UnknownKind {
        /// The file.
        path: PathBuf,
    },
    /// The text is no valid SVG, or the picture is too large.
    #[error("draw {}: {reason}", path.display())]
    Picture {
        /// The file.
        path: PathBuf,
        /// The defect.
        reason: String,
    },
    /// A system call failed.
    #[error("save {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

/// Saves the picture `svg` atomically, as SVG or PNG according to the extension of `path`.
///
/// # Errors
///
/// [`SaveError`], which names the file.
pub fn save(svg: &str, path: &Path) -> Result<(), SaveError> {
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => rasterise(svg).map_err(|reason| SaveError::Picture {
            path: path.to_owned(),
            reason,
        })?,
        _ => {
            let path = path.to_owned();
            return Err(SaveError::UnknownKind { path });
        }
    };
    let write = || {
        let mut file = jostle_atomic_file::begin(path)?;
        file.write_all(&bytes)?;
        jostle_atomic_file::publish(file, path)
    };
    write().map_err(|source| SaveError::Io {
        path: path.to_owned(),
        source,
    })
}

fn rasterise(svg: &str) -> Result<Vec<u8>, String> {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(notosans::REGULAR_TTF.to_vec());
    fonts.set_sans_serif_family("Noto Sans");
    let options = Options {
        fontdb: Arc::new(fonts),
        ..Options::default()
    };
    let tree = Tree::from_str(svg, &options).map_err(|error| error.to_string())?;
    let size = tree
        .size()
        .to_int_size()
        .scale_by(DENSITY)
        .ok_or("it has no size")?;
    let mut pixels = Pixmap::new(size.width(), size.height()).ok_or("it is too large")?;
    let scale = Transform::from_scale(DENSITY, DENSITY);
    resvg::render(&tree, scale, &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| error.to_string())
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::svg::{Anchor, Canvas, INK};

    #[test]
    fn the_extension_selects_the_format_and_others_are_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let picture = Canvas::new(40.0, 30.0).finish();
        let path = directory.path().join("a.svg");
        save(&picture, &path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), picture);
        let path = directory.path().join("a.png");
        save(&picture, &path).unwrap();
        assert!(std::fs::read(&path).unwrap().starts_with(b"\x89PNG"));

        let pdf = save(&picture, &directory.path().join("a.pdf")).unwrap_err();
        assert!(matches!(pdf, SaveError::UnknownKind { .. }), "{pdf}");
        let broken = save("<svg", &directory.path().join("b.png")).unwrap_err();
        assert!(matches!(broken, SaveError::Picture { .. }), "{broken}");
        let nowhere = save(&picture, Path::new("/nowhere/a.svg")).unwrap_err();
        assert!(matches!(nowhere, SaveError::Io { .. }), "{nowhere}");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 2);
    }

    #[test]
    fn text_is_drawn_on_a_machine_without_fonts() {
        let without = rasterise(&Canvas::new(80.0, 30.0).finish()).unwrap();
        let mut canvas = Canvas::new(80.0, 30.0);
        canvas.text((5.0, 20.0), Anchor::Start, 16.0, INK, "π_1 = −0.5");
        assert_ne!(rasterise(&canvas.finish()).unwrap(), without);
    }
}
