//! Videos: what the encoder gets, and what happens without one. A script stands for the encoder.

use crate::cli::fails;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn logicity(folder: &Path, arguments: &[&str], encoder: Option<&Path>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_logicity"));
    command
        .args(arguments)
        .current_dir(folder)
        .env("PATH", "/usr/bin:/bin")
        .env_remove("LOGICITY_FFMPEG");
    if let Some(encoder) = encoder {
        command.env("LOGICITY_FFMPEG", encoder);
    }
    command.output().unwrap()
}

fn script(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, format!("#!/bin/sh\n{text}")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// An encoder that writes the frames as they are, and its arguments beside them.
const COPY: &str = "for last; do :; done\necho \"$*\" > arguments\ncat > \"$last\"\n";

/// Returns the frames of a video that [`COPY`] wrote, and their width and height.
fn frames(folder: &Path, name: &str) -> (Vec<Vec<u8>>, [usize; 2]) {
    let arguments = fs::read_to_string(folder.join("arguments")).unwrap();
    let size = arguments.split(" -s ").nth(1).unwrap().split(' ').next().unwrap();
    let (width, height) = size.split_once('x').unwrap();
    let size = [width, height].map(|side| side.parse().unwrap());
    let bytes = fs::read(folder.join(name)).unwrap();
    let frames: Vec<Vec<u8>> = bytes.chunks_exact(3 * size[0] * size[1]).map(<[u8]>::to_vec).collect();
    assert_eq!(bytes.len(), frames.len() * 3 * size[0] * size[1]);
    (frames, size)
}

#[test]
fn the_encoder_gets_a_frame_for_each_tick() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let encoder = script(folder, "encoder", COPY);
    let run = [
        "run",
        "easy",
        "--ticks",
        "4",
        "--scale",
        "1",
        "--video",
        "city.mp4",
        "--video-speed",
        "25",
    ];
    let output = logicity(folder, &run, Some(&encoder));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("city.mp4"));
    let (of_run, size) = frames(folder, "city.mp4");
    assert_eq!(of_run.len(), 4);
    assert!(size.iter().all(|side| side % 2 == 0), "{size:?}");
    assert!(of_run[0] != of_run[1], "the ticks differ");
    let arguments = fs::read_to_string(folder.join("arguments")).unwrap();
    assert!(
        arguments.contains(" -r 25 ") && arguments.contains("libx264"),
        "{arguments}"
    );
    // The last frame is the picture of the last tick, on even sides.
    let mut last = png::Decoder::new(
        fs::File::open(folder.join("out/last.png"))
            .map(std::io::BufReader::new)
            .unwrap(),
    )
    .read_info()
    .unwrap();
    let mut pixels = vec![0; last.output_buffer_size().unwrap()];
    last.next_frame(&mut pixels).unwrap();
    let wide = 3 * last.info().width as usize;
    let rows = pixels.chunks_exact(wide).zip(of_run[3].chunks_exact(3 * size[0]));
    let same = rows.filter(|(row, frame)| **row == frame[..wide]).count();
    // Poses in turns may differ, since a trace does not have the routes.
    assert!(10 * same > 9 * last.info().height as usize, "{same}");

    // The same run from its trace, a part of it, and two runs side by side.
    let view = ["view", "out/trace.jsonl", "--scale", "1", "--video", "again.mp4"];
    assert!(logicity(folder, &view, Some(&encoder)).status.success());
    assert!(frames(folder, "again.mp4").0 == of_run);
    assert!(!folder.join("city.html").exists(), "a video alone");
    let view = [
        &view[..4],
        &["--video", "part.mp4", "--from", "1", "--ticks", "2", "-o", "city.html"],
    ]
    .concat();
    assert!(logicity(folder, &view, Some(&encoder)).status.success());
    assert!(frames(folder, "part.mp4").0 == of_run[1..3]);
    assert!(folder.join("city.html").exists());
    let rules = ".include \"vocabulary.dl\"\nStop(X) :- IsAtInter(X).\n";
    fs::write(folder.join("other.dl"), rules).unwrap();
    let other = [
        "run",
        "easy",
        "--ticks",
        "3",
        "--rules",
        "other.dl",
        "--no-pictures",
        "--out",
        "other",
    ];
    let output = logicity(folder, &other, None);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let traces = [
        "out/trace.jsonl",
        "other/trace.jsonl",
        "--scale",
        "1",
        "--video",
        "pair.mp4",
    ];
    assert!(
        logicity(folder, &[&["view"], &traces[..]].concat(), Some(&encoder))
            .status
            .success()
    );
    let (pair, [wide, high]) = frames(folder, "pair.mp4");
    assert_eq!(pair.len(), 3);
    assert!(wide >= 2 * (size[0] - 1) && high > size[1], "{wide} x {high}");
}

#[test]
fn videos_are_refused_before_the_run_that_they_would_lose() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let encoder = script(folder, "encoder", COPY);
    let run = ["run", "easy", "--no-pictures", "--ticks"];
    let large = [&run[..], &["1000000", "--video", "city.mp4"]].concat();
    let words = ["limit-exceeded", "a video of", "--from N --ticks N"];
    fails(&logicity(folder, &large, Some(&encoder)), 1, &words);
    assert!(!folder.join("out").exists());
    // A path with a colon is a path, and not an address.
    fs::create_dir(folder.join("10:00")).unwrap();
    let small = [&run[..], &["2", "--scale", "1", "--video", "10:00/city.mp4"]].concat();
    let output = logicity(folder, &small, Some(&encoder));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let arguments = fs::read_to_string(folder.join("arguments")).unwrap();
    assert!(
        arguments.trim_end().rsplit(' ').next().unwrap().starts_with("./10:00/"),
        "{arguments}"
    );
    let view = ["view", "/dev/null", "-o", "page.html", "--video", "city.mp4"];
    fails(&logicity(folder, &view, Some(&encoder)), 2, &["a pipe does not allow"]);
}

#[test]
fn a_missing_or_failing_encoder_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = [
        "run",
        "easy",
        "--ticks",
        "2",
        "--scale",
        "1",
        "--no-pictures",
        "--video",
        "city.mp4",
    ];
    if !Path::new("/usr/bin/ffmpeg").exists() {
        let words = [
            "`--video` needs the program `ffmpeg`",
            "apt-get install ffmpeg",
            "[video]",
            "LOGICITY_FFMPEG",
        ];
        fails(&logicity(folder, &run, None), 2, &words);
        assert!(!folder.join("out/trace.jsonl").exists(), "before the run begins");
    }
    fails(
        &logicity(folder, &run, Some(Path::new("/nowhere"))),
        2,
        &["`/nowhere`, which is no file"],
    );
    let failing = script(
        folder,
        "failing",
        "cat > /dev/null\necho 'unknown encoder' >&2\nexit 3\n",
    );
    fails(
        &logicity(folder, &run, Some(&failing)),
        2,
        &["failing` failed: unknown encoder", "libx264"],
    );
    let silent = script(folder, "silent", "exit 4\n");
    fails(&logicity(folder, &run, Some(&silent)), 2, &["silent` failed"]);
    let names = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    assert_eq!(names.filter(|name| name.contains("mp4")).count(), 0, "no file remains");
    // The trace of the run is there.
    assert!(folder.join("out/trace.jsonl").exists());
    let words = ["cannot go to standard output"];
    fails(
        &logicity(folder, &["view", "out/trace.jsonl", "--video", "-"], Some(&failing)),
        2,
        &words,
    );
    let words = ["--video"];
    fails(
        &logicity(folder, &["view", "out/trace.jsonl", "--crop"], None),
        2,
        &words,
    );
    fails(
        &logicity(folder, &["run", "easy", "--no-trace", "--video", "a.mp4"], None),
        2,
        &["cannot be used with"],
    );
}
