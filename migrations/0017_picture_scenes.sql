-- Hash of the scene that a frame's picture is made from, as the picture's file has it: so a file leads to its job. NULL in rows of
-- earlier releases, and of frames that cannot be evaluated.
ALTER TABLE frame ADD COLUMN scene TEXT;

CREATE INDEX frame_by_scene ON frame (scene) WHERE scene IS NOT NULL;
