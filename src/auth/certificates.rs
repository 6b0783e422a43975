//! Certificates of a private authority: the daemon's, and one for each user.

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Date, Duration, Month, OffsetDateTime};

/// The lifetime of the authority's certificate.
const AUTHORITY_DAYS: i64 = 3650;

/// The lifetime of the certificates of the daemon and of users. There is no revocation list: removed
/// users are no longer in `people.json`.
pub const DAYS: i64 = 825;

/// The tolerated difference between the clocks of two machines.
const SKEW: Duration = Duration::hours(24);

/// The common name of the authority.
const AUTHORITY: &str = "jostle";

/// The common name of the daemon, which no user may have.
pub const DAEMON: &str = "jostled";

/// A certificate and its key, both as PEM.
pub struct Pair {
    /// The certificate.
    pub certificate: String,
    /// Its key.
    pub key: String,
}

/// A private certificate authority.
pub struct Authority(Issuer<'static, KeyPair>);

impl Authority {
    /// Generates the key of a new authority, as PEM.
    pub fn generate_key() -> Result<String, rcgen::Error> {
        Ok(KeyPair::generate()?.serialize_pem())
    }

    /// The authority with this key.
    pub fn of_key(key: &str) -> Result<Self, rcgen::Error> {
        let key = KeyPair::from_pem(key)?;
        Ok(Authority(Issuer::new(authority()?, key)))
    }

    /// Its own certificate, as PEM.
    pub fn certificate(&self) -> Result<String, rcgen::Error> {
        Ok(authority()?.self_signed(self.0.key())?.pem())
    }

    /// A certificate for the daemon, with its names and addresses.
    pub fn certify_daemon(&self, hosts: &[String]) -> Result<Pair, rcgen::Error> {
        let params = CertificateParams::new(hosts)?;
        self.certify(params, DAEMON, ExtendedKeyUsagePurpose::ServerAuth)
    }

    /// A certificate for a user, whose name is its common name.
    pub fn certify_person(&self, name: &str) -> Result<Pair, rcgen::Error> {
        let params = CertificateParams::default();
        self.certify(params, name, ExtendedKeyUsagePurpose::ClientAuth)
    }

    fn certify(
        &self,
        mut params: CertificateParams,
        name: &str,
        purpose: ExtendedKeyUsagePurpose,
    ) -> Result<Pair, rcgen::Error> {
        params.distinguished_name.push(DnType::CommonName, name);
        params.extended_key_usages = vec![purpose];
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.use_authority_key_identifier_extension = true;
        set_validity(&mut params, DAYS);
        let key = KeyPair::generate()?;
        Ok(Pair {
            certificate: params.signed_by(&key, &self.0)?.pem(),
            key: key.serialize_pem(),
        })
    }
}

/// The parameters of the authority's certificate; constant except for the dates.
fn authority() -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(Vec::new())?;
    params
        .distinguished_name
        .push(DnType::CommonName, AUTHORITY);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    set_validity(&mut params, AUTHORITY_DAYS);
    Ok(params)
}

/// The date in so many days, as `2029-02-24`, which sorts by time. The last day of a certificate that is
/// issued today is `in_days(DAYS)`.
pub fn in_days(days: i64) -> String {
    let day = OffsetDateTime::now_utc() + Duration::days(days);
    day.date().to_string()
}

/// The begin of a day as [`in_days`] has it, in seconds since 1970.
pub fn unix_secs(day: &str) -> Option<i64> {
    let mut parts = day.splitn(3, '-');
    let year = parts.next()?.parse().ok()?;
    let month = parts.next()?.parse::<u8>().ok()?;
    let day = parts.next()?.parse().ok()?;
    let date = Date::from_calendar_date(year, Month::try_from(month).ok()?, day).ok()?;
    Some(date.midnight().assume_utc().unix_timestamp())
}

fn set_validity(params: &mut CertificateParams, days: i64) {
    let now = OffsetDateTime::now_utc();
    params.not_before = now - SKEW;
    params.not_after = now + Duration::days(days);
}
