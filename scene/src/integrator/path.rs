//! A ray on its way: what it meets, and how it goes on where surfaces mirror it or let it through.

use super::lighting::{CHOICE, NORMAL_TAPS, SCATTERING};
use super::{Hit, Program, Radiance};
use crate::camera::Ray;
use crate::fog::Fog;
use crate::march::Marched;
use crate::materials::Finish;
use crate::materials::microfacet::{alpha, frame, grazing, sample_visible_normal, shadowing};
use crate::real::{Flag, Real, Vec3, bundle, vec3};
use crate::sampling::Dice;

/// A ray that has been sent on some times.
#[derive(Clone, Copy)]
struct Path<R: Real> {
    ray: Ray<R>,
    /// How near is near enough where it starts.
    near: R,
    /// How far it has come.
    travelled: R,
    /// The share of what it meets that reaches the camera.
    throughput: Vec3<R>,
    color: Vec3<R>,
    /// The share of what lies straight behind that reaches the camera.
    see_through: R,
    evaluations: R,
    bounce: R,
    going: Flag<R>,
}

bundle!(Path { ray, near, travelled, throughput, color, see_through, evaluations, bounce, going });

/// Where a ray goes on, and the share of what it meets then.
#[derive(Clone, Copy)]
struct Onward<R: Real> {
    direction: Vec3<R>,
    weight: Vec3<R>,
    /// Whether it goes to the other side of the surface.
    through: Flag<R>,
}

/// What is met by a ray that was sent on counts as this bright at most: a sharp highlight that few rays meet
/// would leave specks.
const MOST_INDIRECT: f32 = 6.0;
/// Less than this of what a ray meets would not be seen.
const FAINT: f32 = 1.0 / 512.0;

impl Program<'_> {
    /// The light along a ray from the camera.
    #[inline(always)]
    pub(super) fn path<R: Real>(&self, ray: &Ray<R>, dice: &Dice<R>) -> Radiance<R> {
        let (zero, one) = (dice.x.splat(0.0), dice.x.splat(1.0));
        let start = Path {
            ray: *ray,
            near: zero.given(self.tolerance.floor),
            travelled: zero,
            throughput: vec3(one, one, one),
            color: vec3(zero, zero, zero),
            see_through: one,
            evaluations: zero,
            bounce: zero,
            going: Flag(zero.below(1.0)),
        };
        let end = if self.sends_on {
            R::repeat(
                self.scene.march.max_bounces + 1,
                start,
                #[inline(always)]
                |path| {
                    let next = self.segment(path, dice);
                    (next.going.0, next)
                },
            )
        } else {
            self.segment(start, dice)
        };
        // What would be met after the last bounce is taken to be the background.
        let rest = end.throughput.by_channel(self.background(end.ray.direction).0);
        let color = Vec3::select(end.going.0, end.color + rest, end.color);
        let alpha = self.background(end.ray.direction).1;
        let alpha = end.see_through.mul_add(alpha - 1.0, one);
        Radiance { color, alpha, evaluations: end.evaluations }
    }

    /// A path until it meets the next surface, and on from there.
    fn segment<R: Real>(&self, path: Path<R>, dice: &Dice<R>) -> Path<R> {
        path.near.vectorize(
            #[inline(always)]
            || {
                let dice = Dice { bounce: path.bounce, ..*dice };
                let marched = self.march_on(&path.ray, path.near);
                let mut path = path;
                path.evaluations = path.evaluations + marched.steps;
                self.cross_air(&mut path, &marched, &dice);
                let (background, _) = self.background(path.ray.direction);
                let missed = Path {
                    color: path.color + path.throughput.by_channel(background),
                    going: Flag(path.near.below(0.0)),
                    ..path
                };
                R::when(
                    marched.hit.0,
                    missed,
                    #[inline(always)]
                    || self.meet(path, &marched, &dice),
                )
            },
        )
    }

    /// Clouds, volumes and fog between the start of a ray and where it ends.
    #[inline(always)]
    fn cross_air<R: Real>(&self, path: &mut Path<R>, marched: &Marched<R>, dice: &Dice<R>) {
        let farthest = path.near.given(self.scene.march.max_distance.get());
        let length = R::select(marched.hit.0, marched.distance, farthest);
        if let Some(media) = &self.media {
            let crossed = self.cross(media, &path.ray, length, dice);
            path.color = path.color + path.throughput.by_channel(crossed.color);
            path.throughput = path.throughput * crossed.transmittance;
            path.see_through = path.see_through * crossed.transmittance;
            path.evaluations = path.evaluations + crossed.evaluations;
        }
        if let Some(fog) = &self.scene.fog {
            let clear = fog.transmittance(&path.ray, length);
            let color = self.fog_color(fog, path.ray.direction);
            path.color = path.color + path.throughput.by_channel(color) * (clear.splat(1.0) - clear);
            path.throughput = path.throughput * clear;
            path.see_through = path.see_through * clear;
        }
    }

    /// What fog shows in a direction.
    #[inline(always)]
    pub(super) fn fog_color<R: Real>(&self, fog: &Fog, direction: Vec3<R>) -> Vec3<R> {
        match &fog.color {
            Some(color) => Vec3::given(direction.x, color.get()),
            None => self.background(Fog::direction_of_color(direction)).0,
        }
    }

    /// A path at the surface it has met.
    #[inline(always)]
    fn meet<R: Real>(&self, path: Path<R>, marched: &Marched<R>, dice: &Dice<R>) -> Path<R> {
        let zero = path.near.splat(0.0);
        let met = self.hit(&path.ray, marched);
        let hit = Hit { distance: met.distance + path.travelled, ..met };
        let (light, evaluations) = self.lighting(&hit, dice);
        let evaluations = path.evaluations + evaluations + NORMAL_TAPS;
        if !self.sends_on {
            let color = path.color + path.throughput.by_channel(self.dress(&hit, &path.ray, &light));
            return Path { color, evaluations, see_through: zero, going: Flag(zero.above(0.0)), ..path };
        }
        let (seen, finish) = self.dress_and_finish(&hit, &path.ray, &light);
        let seen = Vec3::select(path.bounce.above(0.5), held(seen), seen);
        let color = path.color + path.throughput.by_channel(seen);
        let onward = self.send_on(&hit, -path.ray.direction, &finish, dice);
        let near = self.tolerance.at(hit.distance);
        let side = R::select(onward.through.0, near * -4.0, near * 4.0);
        let ray = Ray { origin: hit.normal.mul_add(side, hit.position), direction: onward.direction };
        let throughput = path.throughput.by_channel(onward.weight);
        // What goes straight through leaves the background behind it to be seen.
        let straight = onward.through.0 & (finish.ior - 1.0).abs().below(1e-4);
        let see_through = R::select(straight, path.see_through * onward.weight.mean(), zero);
        Path {
            ray,
            near,
            travelled: hit.distance,
            throughput,
            color,
            see_through,
            evaluations,
            bounce: path.bounce + 1.0,
            going: Flag(throughput.max_element().above(FAINT)),
        }
    }

    /// Where a ray goes on from a surface: mirrored, or through it where that is what its numbers choose.
    ///
    /// Bruce Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007.
    #[inline(always)]
    fn send_on<R: Real>(&self, hit: &Hit<R>, to_viewer: Vec3<R>, finish: &Finish<R>, dice: &Dice<R>) -> Onward<R> {
        let (zero, one) = (hit.distance.splat(0.0), hit.distance.splat(1.0));
        let frame = Frame::around(hit.normal);
        let viewer = frame.local(to_viewer);
        let viewer = vec3(viewer.x, viewer.y, viewer.z.at_least(1e-3));
        let alpha = alpha(finish.roughness);
        let (u, v) = dice.pair(SCATTERING);
        let facet = sample_visible_normal(viewer, alpha, u, v);
        let cosine = facet.dot(viewer).at_least(1e-4);
        let mirrored = facet.mul_add(cosine + cosine, -viewer);
        let ratio = R::select(hit.inside.0, finish.ior, one / finish.ior.at_least(1e-3));
        let beyond = ratio.square() * (one - cosine.square());
        let cosine_beyond = (one - beyond).sqrt();
        let steep = R::select(finish.ior.above(1.0) & hit.inside.0, cosine_beyond, cosine);
        let reflected = fresnel(finish.mirrored, steep);
        let masked = shadowing(alpha, mirrored.z, viewer.z);
        if !self.lets_through {
            let weight = reflected * R::select(mirrored.z.above(1e-4), masked, zero);
            return Onward { direction: frame.world(mirrored).normalize(), weight, through: Flag(zero.above(0.0)) };
        }
        let total = beyond.above(1.0) & finish.passed.max_element().above(0.0);
        let reflected = Vec3::select(total, vec3(one, one, one), reflected);
        let passed = vec3(one - reflected.x, one - reflected.y, one - reflected.z).by_channel(finish.passed);
        let (of_mirror, of_passage) = (reflected.mean(), passed.mean());
        let likely = of_mirror / (of_mirror + of_passage).at_least(1e-6);
        // Rarely chosen ways would be noise.
        let likely = R::select(likely.below(0.01), zero, likely);
        let (choice, _) = dice.pair(CHOICE);
        let mirrors = choice.lt(likely) | of_passage.below(1e-6);
        let refracted = facet.mul_add(ratio.mul_add(cosine, -cosine_beyond), viewer * -ratio);
        let through = passed * (one / (one - likely).at_least(1e-3));
        let back = reflected * (R::select(mirrored.z.above(1e-4), masked, zero) / likely.at_least(1e-3));
        let direction = Vec3::select(mirrors, mirrored, refracted);
        Onward {
            direction: frame.world(direction).normalize(),
            weight: Vec3::select(mirrors, back, through),
            through: Flag(!mirrors),
        }
    }

    /// Marches on from a surface, or from the camera. `near` is how near is near enough at the start.
    fn march_on<R: Real>(&self, ray: &Ray<R>, near: R) -> Marched<R> {
        near.shared(
            "march_on",
            (*ray, near),
            #[inline(always)]
            |(ray, near)| self.march_within(&ray, near.given(self.tolerance.slope), near, false),
        )
    }
}

/// A colour no brighter than [`MOST_INDIRECT`], in the same hue.
#[inline(always)]
fn held<R: Real>(color: Vec3<R>) -> Vec3<R> {
    let brightest = color.max_element().at_least(MOST_INDIRECT);
    color * (brightest.splat(MOST_INDIRECT) / brightest)
}

/// Schlick's approximation of Fresnel's equations; what mirrors next to nothing does so at every angle.
///
/// Sébastien Lagarde, "Memo on Fresnel equations", 2013: <https://seblagarde.wordpress.com/2013/04/29/memo-on-fresnel-equations/>.
#[inline(always)]
fn fresnel<R: Real>(head_on: Vec3<R>, cosine: R) -> Vec3<R> {
    let most = (head_on.max_element() * 50.0).at_most(1.0);
    let rise = grazing(cosine);
    head_on.map(
        #[inline(always)]
        |channel| (most - channel).at_least(0.0).mul_add(rise, channel),
    )
}

/// A frame around a normal.
#[derive(Clone, Copy)]
struct Frame<R> {
    right: Vec3<R>,
    up: Vec3<R>,
    normal: Vec3<R>,
}

impl<R: Real> Frame<R> {
    #[inline(always)]
    fn around(normal: Vec3<R>) -> Self {
        let (right, up) = frame(normal);
        Self { right, up, normal }
    }

    #[inline(always)]
    fn local(&self, v: Vec3<R>) -> Vec3<R> {
        vec3(v.dot(self.right), v.dot(self.up), v.dot(self.normal))
    }

    #[inline(always)]
    fn world(&self, v: Vec3<R>) -> Vec3<R> {
        self.normal.mul_add(v.z, self.up.mul_add(v.y, self.right * v.x))
    }
}
