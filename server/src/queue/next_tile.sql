SELECT frame, kind FROM tile
 WHERE job = ?5 AND state = 'ready' AND not_before_ms <= ?1
   AND (kind = 'stitch' OR ?6 <= ?4)
   AND (avoid IS NULL OR avoid <> ?2 OR iif(kind = 'stitch', 0, ?6) > ?3)
 ORDER BY job, frame, position LIMIT 1
