!> Runs the cases of a file, a line each: name, address, action, spec, between tabs. Prints a line for each.
program conformance
  use equimesh
  use, intrinsic :: iso_fortran_env, only: real64, int64
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_quiet_nan, ieee_negative_inf
  implicit none
  character(65536) :: line
  character(4096) :: path
  character(:), allocatable :: name, url, action, spec, error
  type(equimesh_service) :: service
  type(equimesh_mesh) :: mesh, empty
  type(equimesh_sequence) :: sequence
  real(real64), allocatable :: u(:), fields(:, :)
  integer :: unit, status, domain
  call get_command_argument(1, path)
  open (newunit=unit, file=trim(path), status='old', action='read')
  do
    read (unit, '(a)', iostat=status) line
    if (status /= 0) exit
    call cut(line, name)
    call cut(line, url)
    call cut(line, action)
    spec = trim(line)
    mesh = empty
    call equimesh_open(service, url)
    if (action == 'step') then
      call equimesh_begin(service, spec, sequence, mesh, error)
    else
      call equimesh_generate(service, spec, mesh, error)
    end if
    if (.not. allocated(error) .and. action /= 'generate') then
      u = mesh%x * mesh%x * mesh%x + mesh%y
      if (action == 'diverge') then
        u(2) = ieee_value(u(2), ieee_quiet_nan)
        u(3) = ieee_value(u(3), ieee_negative_inf)
      end if
      fields = reshape(mesh%x + 2 * mesh%y, [size(u), 1])
      if (action == 'step') then
        call equimesh_step(service, sequence, u, ['T'], fields, mesh, error)
        if (.not. allocated(error)) call equimesh_end(service, sequence, error)
      else
        domain = index(spec, '"domain"')  ! the last member
        if (domain > 0) call equimesh_round(service, u, mesh, error, more=spec(domain:len(spec) - 1))
        if (domain == 0) call equimesh_round(service, u, mesh, error)
      end if
    end if
    if (allocated(error)) then
      write (*, '(a)') name // char(9) // error
    else if (action == 'step') then
      write (*, '(a, 3(i0, 1x), 4(es25.17e3, 1x))') name // char(9), size(mesh%x), size(mesh%cells, 2), size(mesh%cells, 1), &
        total(mesh%x), total(mesh%y), cells_of(mesh), total(fields(:, 1))
    else
      write (*, '(a, 3(i0, 1x), 3(es25.17e3, 1x))') name // char(9), size(mesh%x), size(mesh%cells, 2), size(mesh%cells, 1), &
        total(mesh%x), total(mesh%y), cells_of(mesh)
    end if
    call equimesh_close(service)
  end do

contains

  !> The text before the first tab, which leaves the line.
  subroutine cut(line, word)
    character(*), intent(inout) :: line
    character(:), allocatable, intent(out) :: word
    integer :: tab
    tab = index(line, char(9))
    word = line(:tab - 1)
    line = line(tab + 1:)
  end subroutine

  real(real64) function total(values)
    real(real64), intent(in) :: values(:)
    integer :: k
    total = 0
    do k = 1, size(values)
      total = total + k * values(k)
    end do
  end function

  real(real64) function cells_of(mesh)
    type(equimesh_mesh), intent(in) :: mesh
    cells_of = total(real(reshape(mesh%cells, [size(mesh%cells)]) - 1, real64))
  end function

end program
