-- Failed tiles of each worker, and the message of the last one, for those who look after the workers.

ALTER TABLE worker ADD COLUMN errors INTEGER NOT NULL DEFAULT 0 CHECK (errors >= 0);
ALTER TABLE worker ADD COLUMN last_error TEXT;
