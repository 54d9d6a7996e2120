-- Stored content that no row refers to: see migrations/0016_doomed.sql.
CREATE TABLE doomed (
    kind     TEXT NOT NULL CHECK (kind IN ('picture', 'blob')),
    name     TEXT NOT NULL,
    state    TEXT NOT NULL CHECK (state IN ('marked', 'deleting', 'deleted')),
    since_ms BIGINT NOT NULL,
    PRIMARY KEY (kind, name)
);

CREATE INDEX doomed_by_age ON doomed (since_ms);
