//! Meshes from files that are made here: what is written is what is seen.

use std::path::{Path, PathBuf};

use domvs_simulators::{PinholeCamera, Rendering, SpecError, WorldSpec};

/// Left half black, right half white, 2x2.
fn png() -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(vec![]);
    let picture = image::GrayImage::from_raw(2, 2, vec![0, 255, 0, 255]).expect("four pixels");
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("a PNG");
    bytes.into_inner()
}

/// An empty folder of this test's own.
fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("mesh_files").join(test);
    std::fs::create_dir_all(&folder).expect("a folder below target");
    folder
}

fn rendered(folder: &Path, object: &str) -> Result<Rendering, SpecError> {
    let text = format!("[[scene.objects]]\nshape = \"mesh\"\nposition_m = [0.0, 0.0, 1.0]\n{object}");
    let world = WorldSpec::from_toml(&text)?.build(folder)?;
    let camera = PinholeCamera::with_field_of_view(65, 65, 60.0_f64.to_radians()).expect("possible");
    Ok(world.scene.render(&camera, &world.desired))
}

/// A square of 0.4 m at 1 m: dark on the left, bright on the right, black around.
fn assert_is_the_square(rendering: &Rendering) {
    let image = &rendering.image;
    // Near the middles of its two texels, a quarter from its sides.
    assert!(image.at(26, 32) < 0.1 && image.at(38, 32) > 0.9, "{} | {}", image.at(26, 32), image.at(38, 32));
    assert_eq!((image.at(5, 32), rendering.true_depth.at(5, 32)), (0.0, 0.0));
    assert!((rendering.true_depth.at(40, 32) - 1.0).abs() < 1e-6);
    let covered = rendering.true_depth.samples().iter().filter(|&&z| z > 0.0).count() as f64;
    let side_px: f64 = 0.4 * 65.0 / 2.0 / 30.0_f64.to_radians().tan();
    // Pixel centres in a square of 22.5 px.
    assert!((covered.sqrt() - side_px).abs() < 0.6, "{covered} px, expected {side_px} px squared");
}

/// Four corners, two triangles, texture places from the upper left.
const CORNERS: [[f32; 5]; 4] =
    [[-0.2, -0.2, 0.0, 0.0, 0.0], [0.2, -0.2, 0.0, 1.0, 0.0], [0.2, 0.2, 0.0, 1.0, 1.0], [-0.2, 0.2, 0.0, 0.0, 1.0]];

#[test]
fn an_obj_file_with_its_texture_is_seen_as_written() {
    let folder = folder("obj");
    let mut obj = String::from("mtllib square.mtl\nusemtl halves\n");
    for [x, y, z, s, t] in CORNERS {
        obj += &format!("v {x} {y} {z}\nvt {s} {}\n", 1.0 - t);
    }
    obj += "f 1/1 3/3 2/2\nf 1/1 4/4 3/3\n";
    std::fs::write(folder.join("square.obj"), obj).expect("written");
    std::fs::write(folder.join("square.mtl"), "newmtl halves\nmap_Kd halves.png\n").expect("written");
    std::fs::write(folder.join("halves.png"), png()).expect("written");
    assert_is_the_square(&rendered(&folder, "file = \"square.obj\"").expect("a world"));
    let worn = rendered(&folder, "file = \"square.obj\"\nsize_m = [0.8]\ngray = 1.0").expect("a world");
    assert_eq!((worn.image.at(20, 32), worn.image.at(44, 32)), (1.0, 1.0), "a gray of its own, and twice the size");
}

/// A GLB file: the JSON part, then the binary part, each of whole words.
fn glb(json: &str, mut binary: Vec<u8>) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let total = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = b"glTF".to_vec();
    bytes.extend([2, total as u32].iter().flat_map(|word| word.to_le_bytes()));
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((binary.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(binary);
    bytes
}

#[test]
fn a_glb_file_with_its_texture_and_its_transform_is_seen_as_written() {
    let mut binary: Vec<u8> = vec![];
    for [x, y, z, _, _] in CORNERS {
        // Twice the size and off to the side: the node's transform undoes it.
        binary.extend([2.0 * x + 1.0, 2.0 * y, 2.0 * z].iter().flat_map(|number: &f32| number.to_le_bytes()));
    }
    for [_, _, _, s, t] in CORNERS {
        binary.extend([s, t].iter().flat_map(|number| number.to_le_bytes()));
    }
    binary.extend([0_u16, 2, 1, 0, 3, 2].iter().flat_map(|corner| corner.to_le_bytes()));
    let picture = png();
    let length = picture.len();
    binary.extend(&picture);
    let json = format!(
        r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
        "nodes": [{{"mesh": 0, "scale": [0.5, 0.5, 0.5], "translation": [-0.5, 0, 0]}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0, "TEXCOORD_0": 1}}, "indices": 2, "material": 0}}]}}],
        "materials": [{{"pbrMetallicRoughness": {{"baseColorTexture": {{"index": 0}}}}}}],
        "textures": [{{"source": 0}}], "images": [{{"bufferView": 3, "mimeType": "image/png"}}],
        "accessors": [
            {{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0.6, -0.4, 0], "max": [1.4, 0.4, 0]}},
            {{"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"}},
            {{"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}}],
        "bufferViews": [{{"buffer": 0, "byteOffset": 0, "byteLength": 48}},
            {{"buffer": 0, "byteOffset": 48, "byteLength": 32}}, {{"buffer": 0, "byteOffset": 80, "byteLength": 12}},
            {{"buffer": 0, "byteOffset": 92, "byteLength": {length}}}],
        "buffers": [{{"byteLength": {}}}]}}"#,
        92 + length
    );
    let folder = folder("glb");
    std::fs::write(folder.join("square.glb"), glb(&json, binary)).expect("written");
    assert_is_the_square(&rendered(&folder, "file = \"square.glb\"").expect("a world"));
}

#[test]
fn what_is_no_mesh_file_is_refused_with_its_name() {
    let folder = folder("refused");
    std::fs::write(folder.join("empty.obj"), "v 0 0 0\n").expect("written");
    std::fs::write(folder.join("noise.glb"), [7; 100]).expect("written");
    for (file, says) in
        [("none.obj", "cannot read"), ("thing.stl", ".obj"), ("empty.obj", "got none"), ("noise.glb", "noise")]
    {
        let error = rendered(&folder, &format!("file = \"{file}\"")).expect_err(file).to_string();
        assert!(error.contains(file) && error.contains(says), "{error:?} does not say {file:?} and {says:?}");
    }
    let message = rendered(&folder, "").expect_err("no file").to_string();
    assert!(message.contains("file"), "{message}");
}
