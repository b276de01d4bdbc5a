//! The ten-line program: the twist from where an image was taken to where another one was.
//!
//! `cargo run --example ten_lines -- target.png current.png fx,fy,cx,cy,width,height`, with a `domvs serve` on this machine.

use domvs_client::{Camera, Client, ClientOptions, ImageFile, OutgoingFrame, TaskSettings};

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let (target, current, camera) = arguments()?;
    let client = Client::connect(ClientOptions::named("ten-lines")?).await?;
    let task = client.create_task(&TaskSettings::new(camera)).await?;
    task.set_target(&target).await?;
    task.start().await?;
    let answer = task.twist(&current.numbered(1, 0)).await?;
    println!("{}: {:?} (3 x m/s, 3 x rad/s)", answer.status, answer.twist);
    task.close().await?;
    Ok(client.close().await?)
}

fn arguments() -> anyhow::Result<(OutgoingFrame, OutgoingFrame, Camera)> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [target, current, camera] = arguments.as_slice() else {
        anyhow::bail!("expected target.png current.png fx,fy,cx,cy,width,height");
    };
    let numbers = camera.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
    let [fx, fy, cx, cy, width, height] = numbers[..] else {
        anyhow::bail!("expected fx,fy,cx,cy,width,height, got {camera}");
    };
    let camera = Camera { fx, fy, cx, cy, width: width as u32, height: height as u32, distortion: None };
    let image = |path| anyhow::Ok(OutgoingFrame::file(ImageFile::Png, std::fs::read(path)?)?);
    Ok((image(target)?, image(current)?, camera))
}
