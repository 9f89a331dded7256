//! Opens images for reading. Invariant: what is opened is a regular file, and nothing is waited for:
//! a pipe that nobody writes to would otherwise hold the program before it can be asked what it is.

use crate::error::{Error, Result};
use rustix::fs::OFlags;
use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Opens the regular file `path`, through symbolic links.
///
/// # Errors
/// [`Error::Io`] when it cannot be opened; [`Error::Input`] when it is of another kind.
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    let io = |e| Error::io(path, e);
    let file = open(path, OFlags::NONBLOCK).map_err(io)?;
    if !file.metadata().map_err(io)?.is_file() {
        return Err(Error::file(path, "not a regular file; an image is needed"));
    }
    Ok(file)
}

/// Opens what is at `path` itself if that is a regular file: not what a symbolic link there names.
pub(super) fn open_entry(path: &Path) -> std::io::Result<File> {
    let file = open(path, OFlags::NONBLOCK | OFlags::NOFOLLOW)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(std::io::Error::other("not a regular file")) }
}

fn open(path: &Path, flags: OFlags) -> std::io::Result<File> {
    OpenOptions::new().read(true).custom_flags(flags.bits() as i32).open(path)
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
