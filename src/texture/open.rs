//! Opens images for reading. Never looks at what is in them.

use crate::error::{Error, Result};
use crate::open;
use std::fs::File;
use std::path::Path;

/// Opens the regular file `path`, through symbolic links, and waits for nothing.
///
/// # Errors
/// [`Error::Io`] when it cannot be opened; [`Error::Input`] when it is of another kind.
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    let file = open::open_regular(path).map_err(|e| Error::io(path, e))?;
    file.ok_or_else(|| Error::file(path, "not a regular file; an image is needed"))
}

#[cfg(test)]
mod tests {
    use crate::texture::convert::fingerprint::of_file;
    use crate::texture::image_io::decoded_bytes;
    use crate::texture::read_image;
    use std::time::Duration;

    #[test]
    fn a_pipe_is_refused_and_not_waited_for() {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let path = directory.path().join("fifo.png");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).expect("a pipe");
        let (said, hears) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let results = [
                read_image(&path).map(|_| ()),
                decoded_bytes(&path, true).map(|_| ()),
                of_file(&path).map(|_| ()),
            ];
            let _ = said.send(results);
        });
        let results = hears.recv_timeout(Duration::from_secs(20)).expect("somebody waits for a pipe");
        for result in results {
            let message = result.expect_err("must fail").to_string();
            assert!(message.contains("fifo.png: not a regular file"), "{message}");
        }
    }
}
