//! Files written whole or not at all, and errors that name the file.

use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use crate::error::{Error, Result};

/// How the names of half-written files begin: what a killed program leaves behind can be told
/// from what a user put there.
pub const TEMPORARY_PREFIX: &str = ".twinsight-";

/// Writes a file so that at every moment its path holds either the old content or the new one.
///
/// The bytes go to a temporary file in the same folder, which is then renamed: another process, or
/// this one after a crash, never meets half a file. It does not wait for the disk, so a power cut
/// within seconds may still lose the newest content. A symbolic link stays, and the file that it leads
/// to is written.
///
/// # Errors
/// [`Error::Io`] naming `path` when the folder is missing, read-only or full.
pub fn write_atomically(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    let path = path.as_ref();
    let place = followed(path)?;
    let mut file = temporary_beside(&place, "")?;
    file.write_all(bytes).map_err(Error::io("write", path))?;
    file.persist(&place)
        .map_err(|failure| Error::io("write", path)(failure.error))?;
    Ok(())
}

/// Links that lead to one another further than this lead nowhere, as Linux counts.
const MOST_LINKS: usize = 40;

/// Where a path leads: itself, or what a symbolic link stands for, there or not.
///
/// # Errors
/// [`Error::Io`] naming links that lead to one another without end.
pub fn followed(path: &Path) -> Result<PathBuf> {
    let mut place = path.to_path_buf();
    for _ in 0..=MOST_LINKS {
        let Ok(target) = fs::read_link(&place) else {
            return Ok(place);
        };
        // Relative to the folder of the link; an absolute one stands for itself.
        place = place.parent().unwrap_or(Path::new("")).join(target);
    }
    let endless = std::io::Error::other("symbolic links lead to one another without end");
    Err(Error::io("write", path)(endless))
}

/// Whether a file can be replaced as a whole: pipes and devices are written to as they are, and so is
/// what a running program has open under a name of the system's.
pub fn is_replaceable(path: &Path) -> bool {
    let is_open = ["/dev", "/proc"].iter().any(|root| path.starts_with(root));
    !is_open && fs::metadata(path).map_or(true, |metadata| metadata.is_file())
}

/// Waits until a folder's files are on the disk, so that a power cut no longer loses them.
///
/// # Errors
/// [`Error::Io`] naming what the system could not write.
pub fn sync_folder(folder: &Path) -> Result<()> {
    let sync = |path: &Path| {
        fs::File::open(path)
            .and_then(|file| file.sync_all())
            .map_err(Error::io("write", path))
    };
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        sync(&entry.map_err(Error::io("read", folder))?.path())?;
    }
    // Elsewhere a folder cannot be opened like a file.
    if cfg!(unix) {
        sync(folder)?;
        if let Some(parent) = folder.parent() {
            sync(parent)?;
        }
    }
    Ok(())
}

/// A temporary file in the folder of `path`, to be renamed to it; its name ends in `suffix`.
pub(crate) fn temporary_beside(path: &Path, suffix: &str) -> Result<NamedTempFile> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY_PREFIX).suffix(suffix);
    // Temporary files are private by default; what is written here is an ordinary file, readable
    // by whomever the user's umask lets read it.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder
        .tempfile_in(folder)
        .map_err(Error::io("write", path))
}

/// A file that grows under a temporary name and gets its own when it is finished; a pipe or device
/// is written to as it is. Dropped before it is finished, it leaves nothing behind.
#[derive(Debug)]
pub struct GrowingFile {
    /// Where its content goes, links followed.
    path: PathBuf,
    target: Target,
}

#[derive(Debug)]
enum Target {
    Temporary(BufWriter<NamedTempFile>),
    Device(BufWriter<fs::File>),
}

impl GrowingFile {
    /// Begins a file.
    ///
    /// # Errors
    /// [`Error::Io`] naming `path` when its folder is missing, read-only or full.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        if is_replaceable(path) {
            let path = followed(path)?;
            let target = Target::Temporary(BufWriter::new(temporary_beside(&path, "")?));
            return Ok(Self { path, target });
        }
        let device = fs::OpenOptions::new().write(true).open(path);
        Ok(Self {
            path: path.to_path_buf(),
            target: Target::Device(BufWriter::new(device.map_err(Error::io("write", path))?)),
        })
    }

    /// Adds to the end.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let written = match &mut self.target {
            Target::Temporary(file) => file.write_all(bytes),
            Target::Device(file) => file.write_all(bytes),
        };
        written.map_err(Error::io("write", &self.path))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`Error::Io`] naming the file.
    pub fn finish(self) -> Result<()> {
        let path = self.path;
        match self.target {
            Target::Temporary(file) => {
                let file = file
                    .into_inner()
                    .map_err(|failure| Error::io("write", &path)(failure.into_error()))?;
                file.persist(&path)
                    .map_err(|failure| Error::io("write", &path)(failure.error))?;
            }
            Target::Device(mut file) => file.flush().map_err(Error::io("write", &path))?,
        }
        Ok(())
    }
}

/// Length and check sum of a file's content, to notice later that it was damaged.
///
/// # Errors
/// [`Error::Io`] naming the file.
pub fn content_mark(path: impl AsRef<Path>) -> Result<String> {
    let bytes = fs::read(&path).map_err(Error::io("read", &path))?;
    Ok(mark_of(&bytes))
}

/// The length and check sum of content, as of [`content_mark`].
pub fn mark_of(bytes: &[u8]) -> String {
    format!("{} {:08x}", bytes.len(), crc32fast::hash(bytes))
}

/// Creates a folder and its parents; an existing folder is fine.
///
/// # Errors
/// [`Error::Io`] naming the folder.
pub fn create_folder(path: impl AsRef<Path>) -> Result<()> {
    fs::create_dir_all(&path).map_err(Error::io("create folder", &path))
}

/// Something in a folder, by name; None where the folder is missing or empty. Hidden files, such as
/// a `.gitkeep`, do not count.
///
/// # Errors
/// [`Error::Io`] naming a folder that cannot be read.
pub fn first_entry(folder: impl AsRef<Path>) -> Result<Option<String>> {
    let folder = folder.as_ref();
    if !folder.exists() {
        return Ok(None);
    }
    let mut first: Option<String> = None;
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let name = entry.map_err(Error::io("read", folder))?.file_name();
        let name = name.to_string_lossy().into_owned();
        if !name.starts_with('.') && first.as_ref().is_none_or(|first| name < *first) {
            first = Some(name);
        }
    }
    Ok(first)
}

/// Reads a UTF-8 text file, without the byte order mark that some editors put in front.
///
/// # Errors
/// [`Error::Io`] naming the file when it cannot be read or is not UTF-8.
pub fn read_text(path: impl AsRef<Path>) -> Result<String> {
    let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    Ok(match text.strip_prefix('\u{feff}') {
        Some(rest) => rest.to_owned(),
        None => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_file_replaces_the_old_one_and_leaves_no_other_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("weights.bin");
        write_atomically(&path, b"old").unwrap();
        write_atomically(&path, b"new and longer").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new and longer");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("nowhere").join("a.txt");
        let message = write_atomically(&path, b"x").unwrap_err().to_string();
        assert!(
            message.contains("cannot write") && message.contains("a.txt"),
            "{message}"
        );
    }

    #[test]
    fn a_failed_write_leaves_the_target_and_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("occupied");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("inside"), "kept").unwrap();
        assert!(write_atomically(&path, b"x").is_err());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(fs::read_to_string(path.join("inside")).unwrap(), "kept");
    }

    #[test]
    fn a_growing_file_has_its_name_when_it_is_finished_and_otherwise_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines.txt");
        fs::write(&path, "old").unwrap();
        for finished in [false, true] {
            let mut file = GrowingFile::create(&path).unwrap();
            file.write(b"one\n").unwrap();
            file.write(b"two\n").unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), "old");
            if finished {
                file.finish().unwrap();
            }
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), "one\ntwo\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_symbolic_link_stays_and_what_it_leads_to_is_written() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("disk")).unwrap();
        fs::write(path("disk/old.csv"), "old").unwrap();
        symlink("disk/old.csv", path("relative.csv")).unwrap();
        symlink(path("relative.csv"), path("chain.csv")).unwrap();
        symlink("disk/new.csv", path("dangling.csv")).unwrap();
        for (link, target) in [
            ("relative.csv", "disk/old.csv"),
            ("chain.csv", "disk/old.csv"),
            ("dangling.csv", "disk/new.csv"),
        ] {
            write_atomically(path(link), link.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(path(target)).unwrap(), link);
            let mut file = GrowingFile::create(path(link)).unwrap();
            file.write(b"grown").unwrap();
            file.finish().unwrap();
            assert_eq!(fs::read_to_string(path(target)).unwrap(), "grown");
            assert!(fs::symlink_metadata(path(link)).unwrap().is_symlink());
        }
        // Nothing but the files is left, and endless links are an error.
        assert_eq!(fs::read_dir(path("disk")).unwrap().count(), 2);
        symlink("b", path("a")).unwrap();
        symlink("a", path("b")).unwrap();
        let message = write_atomically(path("a"), b"").unwrap_err().to_string();
        assert!(message.contains("without end"), "{message}");
    }

    #[cfg(unix)]
    #[test]
    fn a_written_file_has_the_permissions_of_an_ordinary_file() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("ordinary"), "").unwrap();
        write_atomically(folder.path().join("ours"), b"").unwrap();
        let mode = |name: &str| {
            fs::metadata(folder.path().join(name))
                .unwrap()
                .permissions()
                .mode()
        };
        assert_eq!(mode("ours"), mode("ordinary"));
    }

    #[test]
    fn text_is_read_without_a_byte_order_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        fs::write(&path, "\u{feff}stamp").unwrap();
        assert_eq!(read_text(&path).unwrap(), "stamp");
    }
}
