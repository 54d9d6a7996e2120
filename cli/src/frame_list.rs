//! Lists of frames, as in `0,4,8-11`, and the files that their pictures go to.

use std::path::Path;
use std::str::FromStr;

use scene::limits::MAX_FRAMES;
use scene::{Format, Job};

use crate::error::UsageError;
use crate::output_file::is_folder;

/// Digits of a frame's number in a file name, unless a pattern has another number of them.
const DIGITS: usize = 4;

/// Numbers of frames in ascending order, each once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct FrameList(Vec<u32>);

impl FromStr for FrameList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut frames = Vec::new();
        for part in text.split(',') {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let number = |digits: &str| digits.trim().parse::<u32>().ok().filter(|number| *number < MAX_FRAMES);
            match (number(first), number(last)) {
                (Some(first), Some(last)) if first <= last => frames.extend(first..=last),
                _ => return Err(format!("{part:?} is not a frame or a range: write them as in 5, 0-11 or 0,4,8-11")),
            }
            // Ranges may overlap.
            frames.sort_unstable();
            frames.dedup();
        }
        Ok(Self(frames))
    }
}

impl FrameList {
    /// The picture's file of each frame: in a folder, or by a pattern such as `shot.####.png`.
    pub(crate) fn files(&self, job: &Job, output: &str) -> anyhow::Result<Vec<(u32, String)>> {
        let (start, digits, end) = if is_folder(output) {
            let extension = match job.image.format {
                Format::Png => "png",
                Format::Exr => "exr",
            };
            let is_plain = |letter: char| letter.is_alphanumeric() || "._- ".contains(letter);
            let name = job.name.trim_start_matches('.').replace(|letter| !is_plain(letter), "-");
            let start = Path::new(output).join(name).to_string_lossy().into_owned();
            (start + ".", DIGITS, format!(".{extension}"))
        } else {
            match (output.find('#'), output.rfind('#')) {
                (Some(first), Some(last)) if output[first..=last].bytes().all(|byte| byte == b'#') => {
                    (output[..first].to_owned(), last + 1 - first, output[last + 1..].to_owned())
                }
                _ => {
                    return Err(UsageError(format!(
                        "{output} is one file: give a folder DIR/ for the frames, or a pattern such as shot.####.png"
                    ))
                    .into());
                }
            }
        };
        let file = |frame: &u32| (*frame, format!("{start}{frame:0digits$}{end}"));
        Ok(self.0.iter().map(file).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_ranges_are_listed_once_in_order() {
        let list = |text: &str| text.parse::<FrameList>().map(|list| list.0);
        assert_eq!(list("5"), Ok(vec![5]));
        assert_eq!(list("0-3"), Ok(vec![0, 1, 2, 3]));
        assert_eq!(list("8-9, 0,4,9-10"), Ok(vec![0, 4, 8, 9, 10]));
        for wrong in ["", "a", "3-1", "1-", "-1", "1,,2", "1-2-3", "0-4294967295"] {
            assert!(list(wrong).is_err_and(|message| message.contains("as in 5, 0-11 or 0,4,8-11")), "{wrong}");
        }
    }
}
