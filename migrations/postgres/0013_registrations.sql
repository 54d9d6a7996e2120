-- Registrations of a key: see migrations/0026_registrations.sql.

CREATE INDEX worker_by_registration ON worker (owner, registered_ms);
