SELECT id, frame, kind, position, x_px, y_px, width_px, height_px, rays, lost FROM tile
 WHERE job = ?5 AND state = 'ready' AND not_before_ms <= ?1
   AND (kind = 'stitch' OR ?6 <= ?4)
   AND (avoid IS NULL OR avoid <> ?2 OR CASE WHEN kind = 'stitch' THEN 0 ELSE ?6 END > ?3)
   AND frame = (SELECT frame FROM tile
       WHERE job = ?5 AND state = 'ready' AND not_before_ms <= ?1
         AND (kind = 'stitch' OR ?6 <= ?4)
         AND (avoid IS NULL OR avoid <> ?2 OR CASE WHEN kind = 'stitch' THEN 0 ELSE ?6 END > ?3)
       ORDER BY job, frame, position LIMIT 1)
 ORDER BY job, frame, position
