//! Job template of the Open Job Description, version `jobtemplate-2023-09`
//! (<https://github.com/OpenJobDescription/openjd-specifications>). It only describes; it renders and writes nothing.

use scene::Job;
use serde_json::{Value, json};

use crate::arguments::DeviceChoice;
use crate::error::UsageError;

/// Maximum number of characters of a template's name.
const MAX_NAME_CHARS: usize = 128;
/// Name of a job without one.
const DEFAULT_NAME: &str = "sdfarm";
/// Time for a render to stop, in seconds; it then deletes its unfinished file.
const STOP_SECONDS: u32 = 10;

/// Device that the tasks render on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Device {
    /// The best one of the host.
    Auto,
    /// A CPU.
    Cpu,
    /// A GPU.
    Cuda,
}

impl Device {
    fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
        }
    }
}

impl TryFrom<DeviceChoice> for Device {
    type Error = UsageError;

    fn try_from(choice: DeviceChoice) -> Result<Self, UsageError> {
        match choice {
            DeviceChoice::Auto(None) => Ok(Self::Auto),
            DeviceChoice::Cpu => Ok(Self::Cpu),
            DeviceChoice::Cuda(None) => Ok(Self::Cuda),
            DeviceChoice::Auto(Some(_)) | DeviceChoice::Cuda(Some(_)) => Err(UsageError(
                "hosts have different GPUs: use --device auto, cpu or cuda, without a number".to_owned(),
            )),
        }
    }
}

/// Template of a job: each frame is a task. `job_file` is the default path of the job file, from the template's folder.
pub(super) fn template(job: &Job, job_file: Option<&str>, device: Device) -> Value {
    let mut file = json!({
        "name": "JobFile", "type": "PATH", "objectType": "FILE", "dataFlow": "IN",
        "description": "The job file of sdfarm."
    });
    if let Some(path) = job_file {
        file["default"] = path.into();
    }
    let last = job.frames.count - 1;
    let frames = if last == 0 { "0".to_owned() } else { format!("0-{last}") };
    let mut step = json!({
        "name": "Render",
        "parameterSpace": {
            "taskParameterDefinitions": [{ "name": "Frame", "type": "INT", "range": "{{Param.Frames}}" }]
        },
        "script": { "actions": { "onRun": {
            "command": "{{Param.Program}}",
            "args": [
                "render", "{{Param.JobFile}}", "--frames", "{{Task.Param.Frame}}", "--output", "{{Param.PictureFolder}}/",
                "--device", "{{Param.Device}}"
            ],
            "cancelation": { "mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": STOP_SECONDS }
        } } }
    });
    if device == Device::Cuda {
        step["hostRequirements"] = json!({ "amounts": [{ "name": "amount.worker.gpu", "min": 1 }] });
    }
    json!({
        "specificationVersion": "jobtemplate-2023-09",
        "name": name(&job.name),
        "parameterDefinitions": [
            file,
            {
                "name": "PictureFolder", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "OUT", "default": "pictures",
                "description": "Folder for the pictures; it is created if missing."
            },
            {
                "name": "Frames", "type": "STRING", "default": frames,
                "description": "Frames to render, as in 0-11 or 0-20:4,30."
            },
            {
                "name": "Device", "type": "STRING", "allowedValues": ["auto", "cpu", "cuda"], "default": device.name(),
                "description": "Device to render on; every choice gives the same pictures."
            },
            {
                "name": "Program", "type": "STRING", "default": "sdfarm",
                "description": "The program, as hosts find it."
            }
        ],
        "steps": [step]
    })
}

/// A job's name as a template can have it: short, without control characters, and without two braces in a row, which
/// start an expression.
fn name(job: &str) -> String {
    let mut plain = String::new();
    for letter in job.trim().chars().map(|letter| if letter.is_control() { ' ' } else { letter }) {
        if !("{}".contains(letter) && plain.ends_with(letter)) {
            plain.push(letter);
        }
    }
    let short: String = plain.trim().chars().take(MAX_NAME_CHARS).collect();
    if short.is_empty() { DEFAULT_NAME.to_owned() } else { short }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(frames: u32) -> Job {
        let text = json!({
            "name": "a {{{b}}} c",
            "scene": {
                "camera": { "position": [0, 0, 5], "look_at": [0, 0, 0] },
                "objects": [{ "material": { "normals": {} }, "shape": { "sphere": { "radius": 1 } } }]
            },
            "image": { "width": 8, "height": 8, "samples": 1 },
            "frames": { "count": frames }
        });
        scene::parse(text.to_string().as_bytes()).expect("a valid job")
    }

    #[test]
    fn each_frame_is_a_task() {
        for (count, range) in [(1, "0"), (2, "0-1"), (240, "0-239")] {
            let template = template(&job(count), Some("a.json"), Device::Auto);
            assert_eq!(template["parameterDefinitions"][2]["default"], range);
            assert_eq!(template["parameterDefinitions"][0]["default"], "a.json");
            assert_eq!(template["steps"][0].get("hostRequirements"), None);
        }
    }

    #[test]
    fn tasks_on_gpus_require_hosts_with_one() {
        let template = template(&job(1), None, Device::Cuda);
        assert_eq!(template["steps"][0]["hostRequirements"]["amounts"][0]["name"], "amount.worker.gpu");
        assert_eq!(template["parameterDefinitions"][3]["default"], "cuda");
        assert_eq!(template["parameterDefinitions"][0].get("default"), None);
    }

    #[test]
    fn names_start_no_expression() {
        for (given, expected) in [
            ("shot 12", "shot 12"),
            ("a {{Param.X}} b", "a {Param.X} b"),
            ("{{{{{", "{"),
            ("}}}}}}", "}"),
            (" \u{7}\n ", "sdfarm"),
            ("", "sdfarm"),
        ] {
            assert_eq!(name(given), expected);
        }
        assert_eq!(name(&"é".repeat(200)), "é".repeat(128));
    }
}
