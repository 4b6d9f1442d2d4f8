function varargout = equimesh (action, varargin)
% Meshes of an equimesh service, for Octave 7 and MATLAB. It needs the program curl.
%
%   mesh = equimesh ('generate', url, spec)
%   mesh = equimesh ('round', url, mesh, u)             % the next mesh for a solution with the values u
%   mesh = equimesh ('round', url, mesh, u, further)    % further: members of the spec, such as its domain
%   [sequence, mesh] = equimesh ('begin', url, spec)
%   [sequence, mesh, fields] = equimesh ('step', sequence, u, fields)
%   equimesh ('end', sequence)
%
% spec is a struct, or JSON text, as in the reference of the HTTP interface:
%   spec.monitor.u.expression = 'tanh(20*(x - y))'; spec.grid = struct ('n_xi', 33, 'n_eta', 33);
%
% A mesh has x, y and u, of size n_xi x n_eta for a grid, n x 1 for blocks; the nodes are numbered along the rows, as in
% mesh.points, n x 2. cells has the nodes of each cell in a row, from 1, counter-clockwise. u and the fields of a step, a
% struct with one field for each name, have the size of x; they are carried to the nodes of the new mesh.
%
% An error has the sentence of the service. The API key is that of the environment variable EQUIMESH_KEY.
  switch action
    case 'generate'
      varargout{1} = mesh_of (send_until_done (varargin{1}, '/v1/meshes?format=npz', text_of (varargin{2})));
    case 'round'
      varargout{1} = next_round (varargin{:});
    case 'begin'
      [file, place] = send_until_done (varargin{1}, '/v1/sequences?format=npz', text_of (varargin{2}));
      mesh = mesh_of (file);
      varargout = {struct('url', varargin{1}, 'address', place, 'step', 0), mesh};
    case 'step'
      [varargout{1}, varargout{2}, varargout{3}] = next_step (varargin{:});
    case 'end'
      send_once (varargin{1}.url, 'DELETE', varargin{1}.address, '', 'end');
    otherwise
      error ('equimesh:input', 'there is no action %s: generate, round, begin, step, end', action);
  end
end

function mesh = next_round (url, mesh, u, further)
  if nargin < 4, further = struct (); end
  if min (size (mesh.x)) > 1
    u = sprintf ('{"nodal":{"x":%s,"y":%s,"values":%s}}', rows (mesh.x), rows (mesh.y), rows (u));
    grid = sprintf (',"grid":{"n_xi":%d,"n_eta":%d}', size (mesh.x, 1), size (mesh.x, 2));
  else
    u = sprintf ('{"block_nodes":{"nodes":%s,"values":[%s]}}', rows (mesh.points), list (u));
    grid = '';
  end
  members = text_of (further);
  members = strtrim (members(2:end-1));
  if ~isempty (members), members = [',' members]; end
  body = sprintf ('{"monitor":{"kind":"nodal_solution","u":%s}%s%s}', u, grid, members);
  mesh = mesh_of (send_until_done (url, '/v1/meshes?format=npz', body));
end

function [sequence, mesh, fields] = next_step (sequence, u, fields)
  if nargin < 3, fields = struct (); end
  names = fieldnames (fields);
  parts = cell (1, numel (names));
  for k = 1:numel (names)
    parts{k} = sprintf ('"%s":%s', names{k}, rows (fields.(names{k})));
  end
  parts = strjoin (parts, ',');
  body = sprintf ('{"step":%d,"u":{"nodes":%s},"fields":{%s}}', sequence.step, rows (u), parts);
  file = send_until_done (sequence.url, [sequence.address '/steps?format=npz'], body);
  [mesh, arrays] = mesh_of (file);
  for k = 1:numel (names)
    fields.(names{k}) = arrays.(names{k});
  end
  sequence.step = sequence.step + 1;
end

function text = text_of (spec)
  if isstruct (spec), text = jsonencode (spec); else, text = char (spec); end
end

function text = rows (values)
% A matrix as JSON, row by row, with all digits.
  width = size (values, 2);
  format = ['[' repmat('%.17g,', 1, width - 1) '%.17g],'];
  text = sprintf (format, values.');
  text = ['[' finite_or_named(text(1:end-1)) ']'];
end

function text = list (values)
  text = sprintf ('%.17g,', values);
  text = finite_or_named (text(1:end-1));
end

function text = finite_or_named (text)
% Infinity by the name that the service knows, which then says where it is. NaN has the same name there.
  text = strrep (text, 'Inf', 'Infinity');
end

function [file, place] = send_until_done (url, path, body)
% Send a request until its mesh is finished: repeated with its key it waits on, and adds no work.
  persistent count
  if isempty (count), count = 0; end
  count = count + 1;
  once = sprintf ('m-%.0f-%d-%.0f', 1e6 * now (), count, 1e9 * rand ());
  status = 202;
  began = tic ();
  while status == 202
    [status, file, place] = send_once (url, 'POST', path, body, once);
    if status == 202, pause (0.5); end
    if status == 202 && toc (began) > 600
      remove (file);
      error ('equimesh:late', 'the mesh was not finished within 600 s: the service at %s goes on with it', url);
    end
  end
end

function [status, file, place] = send_once (url, method, path, body, once)
  url = char (url);
  file = tempname (); head = tempname (); sent = tempname ();
  if ~isempty (body), body = unicode2native (body, 'UTF-8'); end
  handle = fopen (sent, 'w'); fwrite (handle, body); fclose (handle);
  tidy = onCleanup (@() remove (sent, head));
  granted = ''; given = '';
  if ~isempty (getenv ('EQUIMESH_KEY')) && isunix ()  % the shell reads the key, so that no list of processes shows it
    granted = '-K -';
    given = sprintf (' <<END\nheader = "Authorization: Bearer $EQUIMESH_KEY"\nEND\n');
  elseif ~isempty (getenv ('EQUIMESH_KEY'))
    granted = sprintf ('-H "Authorization: Bearer %s"', getenv ('EQUIMESH_KEY'));
  end
  while ~isempty (url) && url(end) == '/', url(end) = ''; end
  if ~isempty (regexp ([url path], '[^\w:/?&=.~@+,\[\]-]', 'once'))  % a shell would read it
    error ('equimesh:input', 'the address %s has characters that are none of an address of a service', [url path]);
  end
  command = ['curl -sS -X %s -o "%s" -D "%s" -w "%%{http_code}" -H "Content-Type: application/json" -H "Expect:" ' ...
             '-H "Prefer: wait=30" -H "Idempotency-Key: %s" %s --max-time 600 --data-binary "@%s" "%s%s" 2>&1%s'];
  [failed, said] = system (sprintf (command, method, file, head, once, granted, sent, url, path, given));
  if failed ~= 0
    error ('equimesh:unreachable', ['the service at %s does not answer (%s): start it with equimesh serve, or give its' ...
           ' address'], url, strtok (said, sprintf ('\n')));
  end
  status = str2double (said(end-2:end));
  place = '';
  found = regexp (fileread (head), '[Ll]ocation: *(\S+)', 'tokens', 'once');
  if ~isempty (found), place = found{1}; end
  if status >= 300
    answer = ''; if exist (file, 'file'), answer = fileread (file); end
    remove (file);
    error ('equimesh:service', '%s', sentence (answer, status, url));
  end
end

function remove (varargin)
  for k = 1:numel (varargin)
    if exist (varargin{k}, 'file'), delete (varargin{k}); end
  end
end

function words = sentence (answer, status, url)
  words = sprintf ('the service answered with HTTP %d and no reason: is %s the address of equimesh?', status, url);
  try
    problem = jsondecode (answer);
    words = problem.title;
    words = problem.detail;
  catch
    % not JSON, or without a detail: what is known is said
  end
end

function [mesh, arrays] = mesh_of (file)
% The mesh in an npz file, which is deleted.
  folder = tempname ();
  mkdir (folder);
  movefile (file, [file '.zip']);
  names = unzip ([file '.zip'], folder);
  arrays = struct ();
  for k = 1:numel (names)
    [~, name] = fileparts (names{k});
    whole = names{k};
    if ~exist (whole, 'file'), whole = fullfile (folder, names{k}); end
    if exist (whole, 'file') == 2 && isvarname (name), arrays.(name) = read_npy (whole); end
  end
  delete ([file '.zip']);
  clean (folder);
  mesh.x = arrays.x; mesh.y = arrays.y;
  mesh.u = [];
  if isfield (arrays, 'u'), mesh.u = arrays.u; end
  mesh.points = [reshape(arrays.x.', [], 1), reshape(arrays.y.', [], 1)];
  mesh.cells = double (arrays.cells) + 1;
end

function clean (folder)
  found = dir (folder);
  for k = 1:numel (found)
    if any (strcmp (found(k).name, {'.', '..'})), continue, end
    whole = fullfile (folder, found(k).name);
    if found(k).isdir, clean (whole); else, delete (whole); end
  end
  rmdir (folder);
end

function values = read_npy (name)
% An array of numbers of 8 bytes or 1 byte, its rows in the order of C.
  handle = fopen (name, 'r', 'ieee-le');
  start = fread (handle, 8, 'uint8=>double');
  if start(7) == 1, length = fread (handle, 1, 'uint16'); else, length = fread (handle, 1, 'uint32'); end
  header = fread (handle, length, 'uint8=>char').';
  types = {'<f8', 'double'; '<i8', 'int64'; '|u1', 'uint8'; '<i4', 'int32'; '<f4', 'single'};
  kind = regexp (header, '''descr'': ''([^'']+)''', 'tokens', 'once');
  place = find (strcmp (types(:, 1), kind{1}));
  values = [];
  if ~isempty (place)
    values = fread (handle, Inf, ['*' types{place, 2}]);
    shape = regexp (header, '''shape'': \(([^)]*)\)', 'tokens', 'once');
    shape = str2double (regexp (shape{1}, '\d+', 'match'));
    if numel (shape) > 1
      values = permute (reshape (values, fliplr (shape)), numel (shape):-1:1);
    end
  end
  fclose (handle);
end
