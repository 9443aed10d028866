/// Round numbers within a range, about `count`, and their texts.
pub(crate) fn ticks(range: (f64, f64), count: usize) -> Vec<(f64, String)> {
    let rough = (range.1 - range.0) / count.max(1) as f64;
    let decade = 10f64.powf(rough.log10().floor());
    let step = decade * [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * decade >= rough).unwrap_or(10.0);
    let decimals = (-step.log10() - 1e-9).ceil().clamp(0.0, 12.0) as usize;
    let (first, last) = ((range.0 / step).ceil() as i64, (range.1 / step).floor() as i64);
    (first..=last)
        .map(|index| {
            let tick = index as f64 * step;
            (tick, format!("{tick:.decimals$}").replace('-', "−"))
        })
        .collect()
}

/// Decimals that resolve a hundred-thousandth of a range.
#[derive(Clone, Copy)]
pub(crate) struct Resolution {
    decimals: usize,
}

impl Resolution {
    pub(crate) fn new(range: (f64, f64)) -> Resolution {
        Resolution { decimals: (5.0 - (range.1 - range.0).abs().log10()).ceil().clamp(0.0, 17.0) as usize }
    }

    /// The number without trailing zeros.
    pub(crate) fn text(self, value: f64) -> String {
        let text = format!("{value:.*}", self.decimals);
        let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        if text == "-0" { "0".to_owned() } else { text.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        let texts = |range, count| ticks(range, count).into_iter().map(|(_, text)| text).collect::<Vec<_>>();
        assert_eq!(texts((-0.23, 0.21), 4), ["−0.2", "0.0", "0.2"]);
        assert_eq!(texts((0.0, 30.0), 6), ["0", "5", "10", "15", "20", "25", "30"]);
        assert_eq!(texts((-1e-3, 1e-3), 2), ["−0.001", "0.000", "0.001"]);
    }

    #[test]
    fn coordinates_have_the_decimals_of_their_range() {
        let text = |range, value| Resolution::new(range).text(value);
        assert_eq!([text((0.0, 86_400.0), 12.5), text((-1.0, 1.0), 1.0 / 3.0)], ["12.5", "0.33333"]);
        assert_eq!([text((0.0, 1e7), 1234.5), text((0.0, 1.0), -1e-9)], ["1234", "0"]);
    }
}
