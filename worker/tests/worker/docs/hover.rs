//! Generates the small pictures that editors show for each kind: the first example of each, as on the pages.

use scene::Job;
use scene::kinds::Example;
use scene::profiles::Profile;
use scene::schema::{Family, node_table};

use super::picture::on_a_floor;
use super::{Page, Picture, camera_and_sky, lights, materials, nodes};

/// Width of the pictures.
const WIDTH_PX: u32 = 112;
/// Folder of the pictures, as seen from docs/.
const FOLDER: &str = "../web/pictures";

/// Folders in `docs/pictures` of the families.
const FOLDERS: [(Family, &str); 7] = [
    (Family::Node, "nodes"),
    (Family::Material, "materials"),
    (Family::Texture, "textures"),
    (Family::Light, "lights"),
    (Family::Background, "backgrounds"),
    (Family::Projection, "projections"),
    (Family::Effect, "effects"),
];

/// A profile, extruded.
fn extruded(profile: &str) -> Job {
    on_a_floor(&format!(
        r#"{{ "shape": {{ "extrude": {{ "profile": {profile}, "height": 0.6 }} }},
            "material": {{ "diffuse": {{ "kd": [0.62, 0.64, 0.68], "ks": [0.12, 0.12, 0.12], "shininess": 30 }} }} }}"#
    ))
}

/// A picture in small.
fn small(mut job: Job) -> Job {
    let height = job.image.height * WIDTH_PX / job.image.width;
    job.image.resize(WIDTH_PX, height);
    job
}

/// The pictures that the table of nodes names; its page is the file that says which are there.
pub(crate) fn page() -> Page {
    let mut large: Vec<(String, Job)> = Vec::new();
    for page in [nodes::page(), materials::page(), lights::page(), camera_and_sky::page()] {
        for Picture { file, job, .. } in page.pictures {
            let shown = FOLDERS.iter().find_map(|(family, folder)| {
                let name = file.strip_prefix(&format!("pictures/{folder}/"))?.strip_suffix(".webp")?;
                Some(format!("/ui/pictures/{}-{name}.webp", family.name()))
            });
            large.extend(shown.map(|shown| (shown, job)));
        }
    }
    for Example { json, .. } in Profile::examples().into_iter().rev() {
        let value: serde_json::Value = serde_json::from_str(&json).expect("an example is JSON");
        let name = value.as_object().and_then(|object| object.keys().next()).expect("a kind is keyed by its name");
        large.push((format!("/ui/pictures/profile-{name}.webp"), extruded(&json)));
    }
    let mut page = Page { name: "../web/pictures/README.md", text: HEAD.to_owned(), pictures: Vec::new() };
    for path in node_table().kinds.into_iter().filter_map(|kind| kind.picture) {
        // Of several examples of a profile, the first one is the last in the list.
        let found = large.iter().rposition(|(shown, _)| *shown == path);
        let (_, job) = large.remove(found.unwrap_or_else(|| panic!("nothing shows {path}")));
        let name = path.strip_prefix("/ui/pictures/").expect("the path of a picture");
        page.pictures.push(Picture::of_first_frame(format!("{FOLDER}/{name}"), small(job)));
    }
    page
}

const HEAD: &str = "# Pictures of the kinds

What editors show for each kind that a job file is written with: the first example of the pages in docs/, small. They are made from
the code: `SDFARM_WRITE_DOCS=1 cargo test -p worker --test worker docs`.
";
