//! `domvs bench images`: the images that are measured on, for whoever wants to measure something else on them.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use image::{ImageBuffer, Luma};

use crate::bench::scene::{Picture, Scene};
use crate::exit;
use crate::options::SizeOption;
use crate::paint::print_line;

/// Write the images that are measured on
///
/// desired.png, current.png and moved.png (8-bit gray), each with the depth that was seen with it in whole millimetres
/// (desired_depth.png and so on, 16 bit). `moved` takes turns with `current` where the window moves.
#[derive(Args, Clone, Debug)]
pub struct ImagesArgs {
    /// Size of the images, pixels
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    size: SizeOption,

    /// A folder for the images
    #[arg(long, value_name = "DIR", default_value = "runs/bench")]
    out: PathBuf,
}

/// Writes them.
pub(super) fn run(args: &ImagesArgs) -> anyhow::Result<ExitCode> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make the folder {}", args.out.display()))?;
    let Scene { desired, current: [near, far] } = Scene::new(args.size);
    for (name, picture) in [("desired", &desired), ("current", &near), ("moved", &far)] {
        write(&args.out, name, picture)?;
    }
    print_line(&format!("images: {}", args.out.display())).context("cannot write the result")?;
    Ok(exit::done())
}

fn write(folder: &Path, name: &str, picture: &Picture) -> anyhow::Result<()> {
    let (width, height) = (picture.size.width as u32, picture.size.height as u32);
    let fits = "one sample for every pixel";
    let path = folder.join(format!("{name}.png"));
    let gray: ImageBuffer<Luma<u8>, _> = ImageBuffer::from_raw(width, height, picture.gray.as_slice()).expect(fits);
    gray.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
    let path = folder.join(format!("{name}_depth.png"));
    let depth: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(width, height, picture.depth_mm.as_slice()).expect(fits);
    depth.save(&path).with_context(|| format!("cannot write {}", path.display()))
}
