-- A sample of 2^log2 conversions: their mean, rounded (a half goes up), the count at the middle one
-- (of an even number, the later of both), and whether any was at an end of the converter.
library ieee;
use ieee.std_logic_1164.all;
use ieee.numeric_std.all;

entity difffric_average is
  port (
    clk : in std_logic;
    clear : in std_logic;  -- takes log2, and forgets the conversions of an unfinished sample
    log2 : in unsigned(2 downto 0);
    converted : in std_logic;
    word : in signed(15 downto 0);
    count : in signed(31 downto 0);
    finishes : out std_logic;  -- this cycle's conversion is a sample's last
    -- The sample, from the next cycle on.
    mean : out signed(15 downto 0) := (others => '0');
    mean_count : out signed(31 downto 0) := (others => '0');
    saturated : out std_logic := '0'
  );
end entity;

architecture rtl of difffric_average is
  constant LOWEST : signed(15 downto 0) := to_signed(-32768, 16);
  constant HIGHEST : signed(15 downto 0) := to_signed(32767, 16);

  signal shift : unsigned(2 downto 0) := (others => '0');
  signal size : unsigned(7 downto 0);  -- 2^shift
  signal number : unsigned(6 downto 0) := (others => '0');  -- of the conversion to come
  signal sum : signed(22 downto 0) := (others => '0');  -- of those before, and half of the size
  signal total : signed(22 downto 0);
  signal any_before : std_logic := '0';  -- of them was at an end
  signal at_an_end, last : std_logic;
begin
  size <= shift_left(to_unsigned(1, 8), to_integer(shift));
  last <= '1' when number = size - 1 else '0';
  total <= sum + word;
  at_an_end <= '1' when word = LOWEST or word = HIGHEST else '0';
  finishes <= converted and last;

  process (clk)
  begin
    if rising_edge(clk) then
      if clear = '1' then
        shift <= log2;
        number <= (others => '0');
        sum <= signed(resize(shift_left(to_unsigned(1, 8), to_integer(log2)) / 2, 23));
        any_before <= '0';
      elsif converted = '1' then
        if number = size / 2 then
          mean_count <= count;
        end if;
        if last = '1' then
          mean <= resize(shift_right(total, to_integer(shift)), 16);
          saturated <= at_an_end or any_before;
          number <= (others => '0');
          sum <= signed(resize(size / 2, 23));
          any_before <= '0';
        else
          number <= number + 1;
          sum <= total;
          any_before <= at_an_end or any_before;
        end if;
      end if;
    end if;
  end process;
end architecture;
