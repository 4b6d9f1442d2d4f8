% Runs the cases of a file, a line each: name, address, action, spec, between tabs. Prints a line for each.
1;
function total = weighed (values)
  values = reshape (values.', [], 1);
  total = sum ((1:numel (values)).' .* values);
end

lines = strsplit (strtrim (fileread (getenv ('CASES'))), "\n");
for k = 1:numel (lines)
  parts = strsplit (lines{k}, "\t");
  [name, url, action, spec] = parts{:};
  try
    fields = struct ();
    if strcmp (action, 'step')
      [sequence, mesh] = equimesh ('begin', url, spec);
      fields.T = mesh.x + 2 * mesh.y;
      [sequence, mesh, fields] = equimesh ('step', sequence, mesh.x .* mesh.x .* mesh.x + mesh.y, fields);
      equimesh ('end', sequence);
    else
      mesh = equimesh ('generate', url, spec);
      u = mesh.x .* mesh.x .* mesh.x + mesh.y;
      if strcmp (action, 'diverge'), u(1, 2) = NaN; u(1, 3) = -Inf; end
      further = ['{' spec(strfind (spec, '"domain"'):end)];
      if isempty (strfind (spec, '"domain"')), further = struct (); end
      if ~strcmp (action, 'generate'), mesh = equimesh ('round', url, mesh, u, further); end
    end
    printf ("%s\t%d %d %d %.17g %.17g %.17g", name, numel (mesh.x), rows (mesh.cells), columns (mesh.cells), ...
            weighed (mesh.x), weighed (mesh.y), weighed (mesh.cells - 1));
    if isfield (fields, 'T'), printf (" %.17g", weighed (fields.T)); end
    printf ("\n");
  catch failure
    printf ("%s\t%s\n", name, failure.message);
  end
end
