use geu_calibration::CountsReader;
use geu_diagnosis::*;
use geu_model::Configuration;
use geu_recording::{InputReader, Options, Reference, Stop};
use std::time::Instant;
fn main() {
    let configuration = Configuration::reference();
    for name in std::env::args().skip(1) {
        let t = Instant::now();
        let (mut reader, mut rows) = (InputReader::new(Options::default(), Stop::default()), CountsReader::default());
        reader.read(&format!("{name}/link.log.gz"), &mut rows).expect("a recording");
        reader.finish(&mut rows).1.expect("a recording");
        let reference = Reference::read(&format!("{name}/reference.csv.gz")).expect("a reference");
        let counts = rows.finish(reference.start_ns).unwrap();
        let measured = Measured::new(counts, &reference).unwrap();
        println!("== {name} read {:?}", t.elapsed());
        let t = Instant::now();
        let case = Case::new(&measured, &configuration);
        println!("case {:?}", t.elapsed());
        let t = Instant::now();
        let bank = Bank::new(&measured, &configuration);
        println!("bank {:?} {} bases", t.elapsed(), bank.bases.len());
        let noise = noise::of(&configuration, &measured, &measured.residual(&measured.run(&configuration, 0.0)));
        println!("{noise:?}");
        let t = Instant::now();
        let mut state = case.start(noise);
        let normal = case.fit(&mut state);
        println!("fit {:?} chi2 {} of {} lag {} {}", t.elapsed(), normal.squares(), normal.count(), state.lag_s, state.lag_sigma_s);
        let t = Instant::now();
        let thresholds = null::thresholds(&case, &bank, &normal, &noise, 1);
        println!("thresholds {:?} {:?}", t.elapsed(), thresholds);
        let t = Instant::now();
        let done = explain::explain(&case, &bank, &thresholds, &case.start(noise));
        println!("explained {:?} chi2 {} of {}", t.elapsed(), done.normal.squares(), done.normal.count());
        for round in &done.rounds {
            println!("--");
            for c in round.candidates.iter().take(6) {
                println!("  {} {:?} {:?} {:?}", c.change.amplitude.code(), c.change.gyros.map(|x| x as u8), c.gain, c.change.parameters().iter().map(|p| p.value).collect::<Vec<_>>());
            }
        }
        println!("unlike {:?} noise {:?}", explain::unlikeness(&done.normal.left()), done.noise);
        for h in &done.state.held {
            println!("HELD {} {:?} {:?} {:?}", h.change.amplitude.code(), h.change.gyros.map(|x| x as u8), h.change.parameters().iter().map(|p| (p.name.clone(), p.value)).collect::<Vec<_>>(), h.sigmas);
        }
    }
}
