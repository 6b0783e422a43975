//! Certificates of a private authority: the daemon's, and one for each person.

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use time::{Duration, OffsetDateTime};

/// How long the authority's own certificate holds.
const AUTHORITY_DAYS: i64 = 3650;

/// How long the daemon's certificate holds, and people's: whoever has left is also gone from
/// `people.json`.
pub const DAYS: i64 = 825;

/// By how much the clocks of two machines may differ.
const SKEW: Duration = Duration::hours(24);

/// What the authority is called.
const AUTHORITY: &str = "jostle";

/// What the daemon is called, and therefore nobody else.
pub const DAEMON: &str = "jostled";

/// A certificate and its key, both as PEM.
pub struct Pair {
    /// The certificate.
    pub certificate: String,
    /// Its key.
    pub key: String,
}

/// A private authority, which signs.
pub struct Authority(Issuer<'static, KeyPair>);

impl Authority {
    /// The key of a new one, as PEM.
    ///
    /// # Errors
    ///
    /// When no key can be made.
    pub fn draw() -> Result<String, rcgen::Error> {
        Ok(KeyPair::generate()?.serialize_pem())
    }

    /// The one that has this key.
    ///
    /// # Errors
    ///
    /// When it is no key.
    pub fn of_key(key: &str) -> Result<Self, rcgen::Error> {
        let key = KeyPair::from_pem(key)?;
        Ok(Authority(Issuer::new(authority()?, key)))
    }

    /// Its own certificate, as PEM.
    ///
    /// # Errors
    ///
    /// When it cannot be signed.
    pub fn certificate(&self) -> Result<String, rcgen::Error> {
        Ok(authority()?.self_signed(self.0.key())?.pem())
    }

    /// A certificate for the daemon, which is reached by these names and addresses.
    ///
    /// # Errors
    ///
    /// For a name that cannot be one.
    pub fn certify_daemon(&self, hosts: &[String]) -> Result<Pair, rcgen::Error> {
        let params = CertificateParams::new(hosts)?;
        self.certify(params, DAEMON, ExtendedKeyUsagePurpose::ServerAuth)
    }

    /// A certificate for a person, whose name is its common name.
    ///
    /// # Errors
    ///
    /// When no key can be made.
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
        hold(&mut params, DAYS);
        let key = KeyPair::generate()?;
        Ok(Pair {
            certificate: params.signed_by(&key, &self.0)?.pem(),
            key: key.serialize_pem(),
        })
    }
}

/// What the authority says of itself; the same each time, but for the dates.
fn authority() -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new(Vec::new())?;
    params
        .distinguished_name
        .push(DnType::CommonName, AUTHORITY);
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    hold(&mut params, AUTHORITY_DAYS);
    Ok(params)
}

/// The last day of a certificate that is made today, as `2029-02-24`.
pub fn last_day() -> String {
    in_days(DAYS)
}

/// The day that is so many days from today; in this form later ones come after earlier ones.
pub fn in_days(days: i64) -> String {
    let day = OffsetDateTime::now_utc() + Duration::days(days);
    day.date().to_string()
}

fn hold(params: &mut CertificateParams, days: i64) {
    let now = OffsetDateTime::now_utc();
    params.not_before = now - SKEW;
    params.not_after = now + Duration::days(days);
}
