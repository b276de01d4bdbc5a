//! The files of `domvs twist`, read and checked against each other.

use std::path::Path;

use anyhow::{Context, ensure};
use domvs_vision::{Depth, DepthMap, HoleFill, Intrinsics, Plane, View};

use super::TwistArgs;
use crate::files::{read_depth, read_gray};
use crate::options::DepthOption;

/// Everything the law needs.
pub struct Inputs {
    pub camera: Intrinsics,
    pub desired: Seen,
    pub current: Seen,
    pub initial: Option<Image>,
    pub mask: Option<Image>,
}

/// An image with the name of its file.
pub struct Image {
    pub name: String,
    pub plane: Plane<f64>,
}

/// An image and its depth.
pub struct Seen {
    pub name: String,
    pub plane: Plane<f64>,
    pub depth: Depth<f64>,
    /// Where the depth came from and what was missing, for the reader.
    pub depth_note: String,
}

impl Seen {
    /// What the law takes.
    pub fn view(&self) -> View<'_, f64> {
        View { image: &self.plane, depth: &self.depth }
    }
}

impl Inputs {
    /// Reads every file that `args` names.
    pub fn read(args: &TwistArgs) -> anyhow::Result<Inputs> {
        let camera = Intrinsics::new(args.camera.focal_px, args.camera.center_px)?;
        let image = |path: &Path| read_image(path, args.invert);
        let desired = image(&args.desired)?;
        let current = image(&args.current)?;
        same_size(&desired, &current)?;
        let initial = args.initial.as_deref().map(image).transpose()?;
        if let Some(initial) = &initial {
            same_size(&desired, initial)?;
        }
        let mask = args.features.mask.as_deref().map(|path| read_image(path, false)).transpose()?;
        if let Some(mask) = &mask {
            same_size(&desired, mask)?;
        }
        let [desired_depth, current_depth] = depth_options(args);
        Ok(Inputs {
            camera,
            desired: with_depth(desired, &desired_depth, args.depth_unit)?,
            current: with_depth(current, &current_depth, args.depth_unit)?,
            initial,
            mask,
        })
    }
}

/// Of the desired and of the current view: what is given for one stands in for the other, and 1 m for both.
fn depth_options(args: &TwistArgs) -> [DepthOption; 2] {
    let either = args.desired_depth.as_ref().or(args.current_depth.as_ref());
    let fallback = either.cloned().unwrap_or(DepthOption::Metres(1.0));
    [&args.desired_depth, &args.current_depth].map(|given| given.clone().unwrap_or_else(|| fallback.clone()))
}

fn read_image(path: &Path, invert: bool) -> anyhow::Result<Image> {
    let mut plane = read_gray(path)?;
    if invert {
        plane.samples_mut().iter_mut().for_each(|value| *value = 1.0 - *value);
    }
    Ok(Image { name: path.display().to_string(), plane })
}

fn same_size(desired: &Image, other: &Image) -> anyhow::Result<()> {
    ensure!(
        size(&desired.plane) == size(&other.plane),
        "{} is {} but {} is {}; all images must have one size",
        desired.name,
        size(&desired.plane),
        other.name,
        size(&other.plane)
    );
    Ok(())
}

/// As people write it: `640x480`.
pub fn size(plane: &Plane<f64>) -> String {
    format!("{}x{}", plane.width(), plane.height())
}

fn with_depth(image: Image, option: &DepthOption, unit_m: f64) -> anyhow::Result<Seen> {
    let (depth, depth_note) = match option {
        DepthOption::Metres(depth_m) => (Depth::Constant { depth_m: *depth_m }, format!("{depth_m} m everywhere")),
        DepthOption::File(path) => read_map(path, unit_m, &image)?,
    };
    Ok(Seen { name: image.name, plane: image.plane, depth, depth_note })
}

fn read_map(path: &Path, unit_m: f64, image: &Image) -> anyhow::Result<(Depth<f64>, String)> {
    let file = read_depth(path, unit_m)?;
    ensure!(
        size(&file.metres) == size(&image.plane),
        "{} is {} but its image {} is {}",
        path.display(),
        size(&file.metres),
        image.name,
        size(&image.plane)
    );
    let map = DepthMap::from_metres(&file.metres, HoleFill::Median).with_context(|| format!("{}", path.display()))?;
    let note = format!("{}, median {:.4} m, {} unknown", path.display(), file.median_m, file.unknown);
    Ok((Depth::Map(map), note))
}
