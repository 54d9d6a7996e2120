SELECT id, frame, kind, position, x_px, y_px, width_px, height_px, rays, lost FROM tile
 WHERE job = ?6 AND state = 'ready' AND not_before_ms <= ?1
   AND (kind = 'stitch' OR ?7 <= ?4)
   AND (avoid IS NULL OR avoid <> ?2 OR CASE WHEN kind = 'stitch' THEN 0 ELSE ?7 END > ?3)
   AND frame = (SELECT frame FROM tile
       WHERE job = ?6 AND state = 'ready' AND not_before_ms <= ?1
         AND (kind = 'stitch' OR ?7 <= ?4)
         AND (avoid IS NULL OR avoid <> ?2 OR CASE WHEN kind = 'stitch' THEN 0 ELSE ?7 END > ?3)
       ORDER BY job, frame, position LIMIT 1)
 ORDER BY job, frame, position
