-- Stored content that no row refers to, before and after its bytes are deleted. Servers that share a database and a bucket
-- use it (server/src/queue/doomed.rs says how); a server alone has a lock in memory instead.
CREATE TABLE doomed (
    kind     TEXT NOT NULL CHECK (kind IN ('picture', 'blob')),
    name     TEXT NOT NULL,
    -- marked: deleted if still no row refers to it after the grace; deleting: a server deletes it; deleted: it was deleted.
    state    TEXT NOT NULL CHECK (state IN ('marked', 'deleting', 'deleted')),
    since_ms INTEGER NOT NULL,
    PRIMARY KEY (kind, name)
) STRICT, WITHOUT ROWID;

CREATE INDEX doomed_by_age ON doomed (since_ms);
