//! The command line: what it accepts, and what it says when it does not.

use super::*;

fn line(text: &str) -> Vec<OsString> {
    std::iter::once("weir").chain(text.split_ascii_whitespace()).map(OsString::from).collect()
}

fn refused(text: &str) -> String {
    match parse(line(text)) {
        Ok(_) => panic!("`weir {text}` was accepted"),
        Err(e) => {
            assert_eq!(e.exit_code(), 2, "{text}");
            let message = e.to_string();
            assert!(!message.contains('\n'), "{message}");
            assert!(message.ends_with("see weir --help"), "{message}");
            message
        }
    }
}

fn settings(text: &str) -> weir::settings::RenderSettings {
    match parse(line(text)) {
        Ok(Command::Render(options)) => options.settings("a.exr".as_ref()),
        Ok(_) => panic!("`weir {text}` is no render"),
        Err(e) => panic!("`weir {text}`: {e}"),
    }
}

#[test]
fn clap_finds_no_fault_with_the_definitions() {
    use clap::CommandFactory;
    Arguments::command().debug_assert();
}

#[test]
fn a_scene_alone_is_rendered() {
    for text in ["a.pbrt", "render a.pbrt", "--spp 4 a.pbrt", "./diff", "-q a.pbrt"] {
        settings(text);
    }
}

#[test]
fn every_option_arrives() {
    let s = settings(
        "a.pbrt -o a.exr -o b.png --spp 16 --time 1.5m --size 640x360 --crop 1,2,30,40 --max-depth 7 \
         --roulette off --seed 9 --threads 2 --backend embree --robust --strict --stats s.json -q",
    );
    assert_eq!(s.outputs, [Path::new("a.exr"), Path::new("b.png")]);
    assert_eq!((s.spp, s.size, s.crop), (Some(16), Some((640, 360)), Some([1, 2, 30, 40])));
    assert_eq!((s.time_limit_seconds, s.max_depth, s.roulette), (Some(90.0), Some(7), Some(false)));
    assert_eq!((s.seed, s.threads, s.robust, s.strict), (Some(9), Some(2), true, true));
    let plain = settings("a.pbrt");
    assert_eq!((plain.spp, plain.roulette, plain.time_limit_seconds), (None, None, None));
    assert!(!plain.robust && !plain.strict && plain.outputs.is_empty());
    assert_eq!(settings("a.pbrt --roulette on").roulette, Some(true));
    assert_eq!(settings("a.pbrt --seed 18446744073709551615").seed, Some(u64::MAX));
}

#[test]
fn errors_asked_for_and_checkpoints_arrive() {
    for text in ["0.02", "2%"] {
        assert_eq!(settings(&format!("a.pbrt --noise {text}")).noise, Some(0.02));
    }
    assert_eq!(settings("a.pbrt --footprint-spp 9").footprint_spp, Some(9));
    let plain = settings("a.pbrt");
    assert_eq!((plain.noise, plain.checkpoint, plain.footprint_spp), (None, None, None));
    // The images are `a.exr` and what else is asked for.
    let kept = settings("a.pbrt -o a.exr -o b.png --resume --checkpoint-every 5m").checkpoint;
    assert_eq!(kept, Some(weir::settings::Checkpointing { path: "a.exr.weir".into(), every_seconds: 300.0 }));
}

#[test]
fn times_have_units() {
    for (text, expected) in [("60s", 60.0), ("90", 90.0), ("2m", 120.0), ("1h", 3600.0), ("250ms", 0.25)] {
        assert_eq!(settings(&format!("a.pbrt --time {text}")).time_limit_seconds, Some(expected));
    }
}

#[test]
fn errors_say_what_would_be_right_in_one_line() {
    for (text, needed) in [
        ("", "no scene given"),
        ("rendr a.pbrt", "render, plan, compare, cost, diff, info, report, texture and generate"),
        ("render", "<SCENE>"),
        ("diff a.exr", "<B>"),
        ("a.pbrt b.pbrt", "'b.pbrt'"),
        ("a.pbrt --spp 0", "from 1 to"),
        ("a.pbrt --spp many", "--spp"),
        ("a.pbrt --spp -3", "--spp"),
        ("a.pbrt --seed -1", "--seed"),
        ("a.pbrt --size -4x3", "1280x720"),
        ("a.pbrt --sp 3", "--spp"),
        ("a.pbrt --size 640", "1280x720"),
        ("a.pbrt --size 0x9", "1280x720"),
        ("a.pbrt --size 4294967295x4294967295", "at most"),
        ("a.pbrt --crop 1,2,3", "100,50,300,200"),
        ("a.pbrt --crop 5,0,5,9", "x1 must be above x0"),
        ("a.pbrt --crop -1,0,5,9", "whole numbers"),
        ("a.pbrt --time 5parsecs", "60s"),
        ("a.pbrt --time 0s", "above zero"),
        ("a.pbrt --time -3s", "a time "),
        ("a.pbrt --roulette maybe", "on, off"),
        ("a.pbrt --backend optix", "embree, native"),
        ("a.pbrt --threads 0", "from 1 to"),
        ("a.pbrt --max-depth deep", "--max-depth"),
        ("a.pbrt --noise 0", "0.02 or 2% is"),
        ("a.pbrt --noise 3", "from 0.0001 to 1"),
        ("a.pbrt --noise little", "0.02 or 2% is"),
        ("a.pbrt --noise nan%", "0.02 or 2% is"),
        ("a.pbrt --noise -2%", "0.02 or 2% is"),
        ("a.pbrt --footprint-spp 0", "from 1 to"),
        ("a.pbrt --checkpoint-every 5s", "--resume"),
        ("a.pbrt --resume --checkpoint-every often", "60s"),
        ("a.pbrt --display", "--display"),
        ("diff a.exr b.exr --fail-above -1", "--fail-above"),
        ("diff a.exr b.exr --fail-above nan", "at least 0"),
    ] {
        let message = refused(text);
        assert!(message.contains(needed), "`weir {text}` lacks {needed}: {message}");
    }
}

#[test]
fn help_lists_only_what_exists() {
    for text in ["--help", "-h", "help"] {
        let Ok(Command::Help(help)) = parse(line(text)) else { panic!("`weir {text}` is help") };
        for needed in [
            "render",
            "plan",
            "compare",
            "cost",
            "diff",
            "info",
            "report",
            "generate",
            "Examples:",
            "Exit codes",
        ] {
            assert!(help.contains(needed), "{needed}");
        }
        assert!(!help.contains("serve"), "{help}");
    }
    let Ok(Command::Help(help)) = parse(line("render --help")) else { panic!("help") };
    for option in ["--spp", "--time", "--crop", "--stats", "--roulette", "Ctrl-C", "Examples:"] {
        assert!(help.contains(option), "{option}");
    }
    let Ok(Command::Help(version)) = parse(line("--version")) else { panic!("version") };
    assert_eq!(version.trim(), concat!("weir ", env!("CARGO_PKG_VERSION")));
}
